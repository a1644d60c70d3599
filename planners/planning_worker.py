"""What a pool of planners needs of each of its workers, wherever that is."""

from __future__ import annotations

from typing import Protocol

from planners.problem import Answer, Request
from planners.scene import Scene


class PlanningWorker(Protocol):
    """Works on one request at a time."""

    @property
    def takes_questions(self) -> bool:
        """True when it is near enough for questions, which are asked many times a second."""

    @property
    def usable(self) -> bool:
        """True when it can take a request now."""

    def run_delay_s(self) -> float | None:
        """Read for how long it has waited for a core since its start [s]; None where that is not known."""

    def has(self, scene: Scene) -> bool:
        """Tell whether a request in this scene can begin without the scene being sent."""

    async def ask(self, request: Request, scene: Scene) -> Answer:
        """Answer a request in a scene.

        The wait has no end of its own; who gives it up must :meth:`cancel` or :meth:`kill`. COMMUNICATION_FAILURE says
        that the worker is out of reach, and nothing of the request.
        """

    async def cancel(self) -> None:
        """Give up the request in hand; afterwards it takes others, if it is usable."""

    async def kill(self) -> None:
        """End what works on the request by force; usable afterwards only where another can take its place at once."""
