"""Exceptions of ``robot``: one class per fact, with the facts as attributes."""

from collections.abc import Sequence
from pathlib import Path


class RobotError(Exception):
    """Base class: something that the arm, its bus or its files refuse or fail at."""


class PortError(RobotError):
    """Serial port that cannot be used."""

    def __init__(self, port: str, problem: str) -> None:
        super().__init__(f"serial port {port} {problem}")


class PortBusy(PortError):  # noqa: N818 - named by the fact, as its siblings
    """Device in use by another process."""

    def __init__(self, port: str) -> None:
        super().__init__(port, "is in use by another process: one program at a time can drive the servos")


class PortLost(PortError):  # noqa: N818 - named by the fact, as its siblings
    """Loss of an open device: it went away, or stopped taking bytes."""

    def __init__(self, port: str, reason: str) -> None:
        super().__init__(port, f"was lost: {reason}")


class NoReply(RobotError, TimeoutError):  # noqa: N818 - named by the fact
    """Servo without a valid reply in time, after all attempts."""

    def __init__(self, servo_id: int, attempts: int) -> None:
        super().__init__(f"servo {servo_id} gave no valid reply to {attempts} instructions")


class CalibrationError(RobotError):
    """Calibration file that cannot be used; the field is a place in it, as ``joint.key``, empty for the whole file."""

    def __init__(self, file: str, field: str, problem: str) -> None:
        where = f"{file}, {field}" if field else file
        super().__init__(f"calibration {where}: {problem}")


class BackupError(RobotError):
    """Backup of servo registers that cannot be read or written."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(f"backup {path} {problem}")


class DescriptionError(RobotError):
    """URDF or SRDF that does not describe an arm; the source is a file, or an element in it."""

    def __init__(self, source: str, problem: str) -> None:
        super().__init__(f"{source} {problem}")


class RobotFileError(DescriptionError):
    """Folder of a robot that does not describe one, with everything that is wrong, a sentence each."""

    def __init__(self, path: Path, problems: Sequence[str]) -> None:
        super().__init__(str(path), "; ".join(problems))
        self.problems = tuple(problems)


class StartupError(RobotError):
    """Servos that cannot be taken over in their present state; the text says what to do."""


class OrderRefused(RobotError):  # noqa: N818 - named by the fact
    """Order that the arm cannot carry out in its present state; the text says why."""
