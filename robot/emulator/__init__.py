"""Emulated servo bus: six STS3215 on a pseudo terminal, for work without an arm.

It speaks the servos' protocol byte by byte, so that a host cannot tell it from a serial port. ``armbridge emulate`` or
``python -m robot.emulator`` runs it; ``--help`` lists the random faults, ``robot.emulator.control``
the commands that change it while it runs.

Modelled:

* Registers: EPROM that outlives a power cut only when written unlocked, signs, homing offset, positions that wrap after
  a turn unless PHASE bit 4 lets them count on, goals cut at the angle limits, read-only registers, the id and the baud
  rate of each servo.
* Populations (:mod:`robot.emulator.populations`): servos as other programs, other makers and the factory leave them.
* Instructions: ping, also broadcast; read; write; kept writes and action; sync read and write; restore, reboot,
  backup, reset, calibrate. TORQUE_ENABLE 128 makes the present position the middle.
* Wire: half-duplex at 1 Mbaud, return delay, response level; servos with the same id reply over each other; a host that
  sends during replies loses them and is not heard; replies delivered in USB frames on request; a host at the wrong baud
  rate is not heard.
* Motion: trapezoidal profile under the acceleration and velocity registers, P loop with lag, torque limit, mechanical
  stops, weight by the pose, obstacles, pushes, a hand that moves the joint.
* Protection: overload timer and latch (status bit 5, 20 % of torque left), overcurrent, temperature, voltage; motors
  warm with their current. Error bits cut torque as register UNLOADING_CONDITION says.
* Faults: replies lost, damaged, of a wrong id, cut, doubled, noisy, late; instructions lost; servos cut off, rebooted,
  relaxed without an instruction; a frozen adapter; an unplugged one that comes back, also under another name.

Not modelled: collisions of links with each other or the table (obstacles stop one joint), inertia, backlash,
payload, D and I gain, dead zone and least force; operating modes other than position; a supply that sags under load
or reboots servos by itself; the damping of TORQUE_ENABLE 2 (the joint is free); the garbage heard
at a wrong baud rate (there is silence); the host's bytes each at its own time (instructions that arrive together are
taken one after the other); the times of registers 37 to 39. The behaviour of real
servos in these cases, and whether switching torque off clears an overload (here it does, unless configured otherwise),
can only be measured on a real arm; servos of other makers are reported to ignore torque off then.
"""
