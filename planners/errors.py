"""Errors of the planners: for a robot or a file that cannot be planned for; a goal that fails is data.

* :exc:`PlannerError`

  * :exc:`ShapeError`
  * :exc:`ProblemFileError`
  * :exc:`PlottingError`
  * :exc:`BatchError`
  * :exc:`StoppedError`
  * :exc:`AssistantError`
"""

from __future__ import annotations


class PlannerError(Exception):
    """Base of the errors of this package."""


class ShapeError(PlannerError):
    """The collision shapes of a robot description cannot be used.

    Attributes:
        subject: the file, or the link whose shape it is.
        reason: the flaw.
    """

    def __init__(self, subject: str, reason: str) -> None:
        super().__init__(f"collision shapes of {subject!r}: {reason}")
        self.subject = subject
        self.reason = reason


class ProblemFileError(PlannerError):
    """A file of planning problems cannot be used.

    Attributes:
        path: the file.
        field: the field that is wrong, its parts joined by dots; empty when it is the file as such.
        reason: the flaw.
    """

    def __init__(self, path: str, field: str, reason: str) -> None:
        super().__init__(f"{path}: {field}: {reason}" if field else f"{path}: {reason}")
        self.path = path
        self.field = field
        self.reason = reason


class PlottingError(PlannerError):
    """A picture cannot be drawn."""


class BatchError(PlannerError):
    """A batch of problems cannot be planned on a Dask cluster."""


class StoppedError(PlannerError):
    """A request is cancelled in the middle of a check that would go on for long; its answer is PREEMPTED."""


class AssistantError(PlannerError):
    """A URDF cannot be imported; the text is one sentence that names the file or option and the remedy."""
