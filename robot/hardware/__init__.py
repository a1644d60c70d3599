"""Hardware interface of an arm, and its back ends: servos of a family on a serial port, and the ideal arm."""
