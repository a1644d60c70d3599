"""Joins an armbridge server to the ROS graph."""
