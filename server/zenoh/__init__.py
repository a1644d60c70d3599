"""Topics and services shared over a zenoh network, with other servers and with ROS 2 machines that use rmw_zenoh."""
