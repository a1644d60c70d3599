"""What can go wrong in the room ``robot``: one class per fact, with the facts as attributes.

- RobotError
    - PortError: the serial port (port)
        - PortNotFound
        - PortPermission
        - PortBusy
        - PortLost
    - BusError: the servos on it
        - NoReply (servo_id), also a TimeoutError
    - CalibrationError (file, field)
    - DescriptionError (source): a URDF or SRDF
    - StartupError: servos that cannot be taken over as they are
    - OrderRefused: an order that cannot be carried out as things are
"""

from __future__ import annotations


class RobotError(Exception):
    """Anything the arm, its bus or its files refuse or fail at."""


class PortError(RobotError):
    """A serial port that cannot be used.

    Attributes:
        port: path or URL of the port.
    """

    def __init__(self, port: str, problem: str) -> None:
        super().__init__(f"serial port {port} {problem}")
        self.port = port


class PortNotFound(PortError):  # noqa: N818 - named by the fact, as its siblings
    """No such device: not plugged in, or under another name."""

    def __init__(self, port: str) -> None:
        super().__init__(port, "does not exist: is the adapter plugged in? /dev/serial/by-id/ lists those that are")


class PortPermission(PortError):  # noqa: N818 - named by the fact, as its siblings
    """The user may not open the device."""

    def __init__(self, port: str) -> None:
        super().__init__(
            port,
            "may not be opened by this user: join the group dialout (`sudo usermod -aG dialout $USER`, then log"
            ' in anew) or add a udev rule for the adapter (MODE="0666")',
        )


class PortBusy(PortError):  # noqa: N818 - named by the fact, as its siblings
    """Another process holds the device."""

    def __init__(self, port: str) -> None:
        super().__init__(port, "is in use by another process: one program at a time can drive the servos")


class PortLost(PortError):  # noqa: N818 - named by the fact, as its siblings
    """The device went away, or stopped taking bytes, while it was open."""

    def __init__(self, port: str, reason: str) -> None:
        super().__init__(port, f"was lost: {reason}")


class BusError(RobotError):
    """The servos on the bus do not do what was asked."""


class NoReply(BusError, TimeoutError):  # noqa: N818 - named by the fact
    """A servo gave no valid reply in time, however often it was asked.

    Attributes:
        servo_id: the servo that was asked.
        attempts: how often it was asked.
    """

    def __init__(self, servo_id: int, attempts: int) -> None:
        super().__init__(f"servo {servo_id} gave no valid reply to {attempts} instructions")
        self.servo_id = servo_id
        self.attempts = attempts


class CalibrationError(RobotError):
    """A calibration file that cannot be used.

    Attributes:
        file: path of the file.
        field: where in it, as ``joint.key``; empty when it is the whole file.
    """

    def __init__(self, file: str, field: str, problem: str) -> None:
        where = f"{file}, {field}" if field else file
        super().__init__(f"calibration {where}: {problem}")
        self.file = file
        self.field = field


class DescriptionError(RobotError):
    """A URDF or SRDF that does not describe an arm.

    Attributes:
        source: the file, or the element in it.
    """

    def __init__(self, source: str, problem: str) -> None:
        super().__init__(f"{source} {problem}")
        self.source = source


class StartupError(RobotError):
    """Servos that cannot be taken over as they are; the text says what to do."""


class OrderRefused(RobotError):  # noqa: N818 - named by the fact
    """An order to the arm that cannot be carried out as things are; the text says why."""
