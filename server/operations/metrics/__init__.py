"""What ``/metrics`` tells, a module a subject; loaded when somebody asks for the first time."""
