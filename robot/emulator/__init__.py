"""Emulated servo buses, for work without an arm: Feetech's STS3215 and Dynamixel's XL430 and XL330.

``armbridge emulate`` or ``python -m robot.emulator`` runs Feetech's on a pseudo terminal, byte by byte as on a serial
port; the arm process runs either inside itself. One servo (``servo``), one bus (``servo_bus``) and one plant serve both
families; ``feetech`` and ``dynamixel`` add registers and packets. docs/simulation.md lists the modelled effects.

Whether switching torque off clears an overload (here it does, unless configured otherwise) can only be measured on a
real arm; servos of other makers are reported to ignore torque off then. At a wrong baud rate there is silence, where a
real bus has garbage. Instructions that arrive together are taken one after the other.
"""
