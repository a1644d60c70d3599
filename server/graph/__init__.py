"""The ROS graph inside the server: topics, services and actions, and the nodes that take part.

Names of topics, services and actions are fully qualified, names of types canonical, as ``std_msgs/msg/String``.
"""
