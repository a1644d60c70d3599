"""Monitoring for the operator: health, metrics, systemd, signals, and diagnostics and logs in ROS."""
