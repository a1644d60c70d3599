"""Errors of the planners: for a robot or a file that cannot be planned for; a goal that fails is data."""

from __future__ import annotations


class PlannerError(Exception):
    """Base of the errors of this package."""


class ShapeError(PlannerError):
    """Collision shapes that cannot be used; ``subject`` is the file, or the link whose shape it is."""

    def __init__(self, subject: str, reason: str) -> None:
        super().__init__(f"collision shapes of {subject!r}: {reason}")


class ProblemFileError(PlannerError):
    """A file of planning problems cannot be used; ``field`` is the wrong field, its parts joined by dots, or empty."""

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
