"""Error of the assistant."""

from __future__ import annotations

from planners.errors import PlannerError


class AssistantError(PlannerError):
    """A URDF cannot be imported; the text is one sentence that names the file or option and the remedy."""
