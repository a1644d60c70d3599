"""The ROS graph inside the server: topics, services and actions, and the nodes that take part."""
