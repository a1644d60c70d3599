"""An emulated servo bus: six STS3215 on a pseudo terminal, for whoever has no arm at hand.

It speaks the servos' protocol byte by byte, so the driver cannot tell it from a serial port. It does not
model contact with the world or between links, gravity that changes with the pose, heat, the overload timer,
or bytes that collide.
"""
