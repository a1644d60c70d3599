"""Errors of the planners: only for a robot that cannot be planned for; a goal that fails is data.

* :exc:`PlannerError`

  * :exc:`ShapeError`
"""

from __future__ import annotations


class PlannerError(Exception):
    """Base of the errors of this room."""


class ShapeError(PlannerError):
    """The collision shapes of a robot description cannot be used.

    Attributes:
        subject: the file, or the link whose shape it is.
        reason: what is wrong with it.
    """

    def __init__(self, subject: str, reason: str) -> None:
        super().__init__(f"collision shapes of {subject!r}: {reason}")
        self.subject = subject
        self.reason = reason
