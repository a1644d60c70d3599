"""Commissioning of the arm by a client: the services and the topic under ``/arm/commissioning/``.

One procedure at a time, for all admins alike: it outlives the connection of the client that has begun it, so that a
page may be loaded again, and ends when nobody has answered for a quarter of an hour.
"""

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol, TypeVar

from robot.commissioning.session import Step, SweptRange
from robot.errors import RobotError
from robot.messages import ArmHealth, ArmState
from server.errors import ServiceError
from server.graph.permissions import COMMISSIONING, CONFIGURING
from server.graph.topics import LocalGraph
from server.lifecycle import end_task

log = logging.getLogger("armbridge.commissioning")

BEGIN = "/arm/commissioning/begin"
ANSWER = "/arm/commissioning/answer"
CANCEL = "/arm/commissioning/cancel"
STATE_TOPIC = "/arm/commissioning/state"

# A person who fetches a screwdriver is back by then.
IDLE_TIMEOUT_S = 900.0

# Live ranges of a sweep: as often as an eye follows.
SHOWN_EVERY_S = 0.1

# Longest name of a step and of an answer in a refusal.
MAX_SHOWN = 80

Accepted = TypeVar("Accepted")


@dataclass(frozen=True)
class Ended:
    """End of a procedure."""

    result: str = ""
    findings: tuple[str, ...] = ()


class ProcedureFailed(RobotError):  # noqa: N818 - named by the fact
    """A procedure cannot go on; the text says why."""


class Dialogue:
    """Conversation of a procedure with the person: the present step, and the answer that is waited for.

    ``progress`` is 0 to 1; ``changed`` is called after every change of the shown state.
    """

    def __init__(self, procedure: str, changed: Callable[[], None]) -> None:
        self.procedure = procedure
        self._changed = changed
        self.step = Step("", "", ())
        self.progress = 0.0
        self.findings: list[str] = []
        self.ranges: Sequence[SweptRange] = ()
        self.droops_rad: dict[str, float] = {}
        self._accept: Callable[[str], None] | None = None
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def ask(self, step: Step, accept: Callable[[str], Accepted], current: Callable[[], Step | None]) -> Accepted:
        """Ask until ``accept`` raises no RobotError for an answer; a refused answer leads to the ``current`` step."""
        accepted: asyncio.Future[Accepted] = asyncio.get_running_loop().create_future()

        def take(answer: str) -> None:
            try:
                accepted.set_result(accept(answer))
            except RobotError:
                self.step = current() or self.step
                self._changed()
                raise
            self._accept = None

        self.step, self._accept = step, take
        self._changed()
        try:
            await self._unless_failed(accepted, IDLE_TIMEOUT_S)
        finally:
            self._accept = None
        if not accepted.done():
            raise ProcedureFailed(f"nobody has answered for {IDLE_TIMEOUT_S / 60.0:.0f} minutes")
        return accepted.result()

    def show(self, name: str, instruction: str) -> None:
        """Show a step that takes no answer."""
        self.step = Step(name, instruction, ())
        self._changed()

    async def until(self, done: asyncio.Future[Accepted], timeout_s: float) -> Accepted:
        await self._unless_failed(done, timeout_s)
        if not done.done():
            raise ProcedureFailed(f"{self.step.name} took more than {timeout_s:g} s")
        return done.result()

    async def _unless_failed(self, done: asyncio.Future[Accepted], timeout_s: float) -> None:
        waiting: list[asyncio.Future[Any]] = [done, self._failure]
        await asyncio.wait(waiting, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        if self._failure.done():
            self._failure.result()

    def answer(self, step: str, answer: str) -> str:
        """Take an answer to the present step; return what comes next."""
        if self._accept is None or step != self.step.name:
            raise ServiceError(
                f"step {step[:MAX_SHOWN]!r} is not asked about: the present one is {self.step.name!r}, "
                f"{'which takes no answer' if self._accept is None else 'with ' + ', '.join(self.step.answers)}"
            )
        if answer not in self.step.answers:
            raise ServiceError(
                f"answer {answer[:MAX_SHOWN]!r} is no answer of step {step!r}: it takes {', '.join(self.step.answers)}"
            )
        self._accept(answer)
        return f"{step}: {answer}"

    def fail(self, reason: str) -> None:
        if not self._failure.done():
            self._failure.set_exception(ProcedureFailed(reason))
            # A procedure that ends of itself at the same time does not ask for it.
            self._failure.exception()


class Procedure(Protocol):
    """One procedure."""

    async def run(self, dialogue: Dialogue) -> str:
        """Carry it out, from the first question to the sentence on how it ended."""

    def take_state(self, state: ArmState, dialogue: Dialogue) -> None:
        """Take the arm's latest state."""

    def take_health(self, health: ArmHealth) -> None:
        """Take the arm's latest health."""

    def close(self) -> None:
        """Release what it holds; called once, at its end."""


class Commissioning:
    """Services and topic of the procedures; ``make`` raises a RobotError when a procedure cannot begin."""

    def __init__(self, graph: LocalGraph, make: Callable[[str, str], Procedure], ended: Ended) -> None:
        self._make = make
        self._ended = ended
        self._node = graph.node("commissioning")
        self._procedure: Procedure | None = None
        self._dialogue: Dialogue | None = None
        self._task: asyncio.Task[None] | None = None
        self._shown: dict[str, Any] | None = None
        self._shown_at_s = -math.inf
        self._health: ArmHealth | None = None
        self._node.advertise(STATE_TOPIC, "armbridge_msgs/CommissioningState", latch=True)
        self._node.offer(BEGIN, "armbridge_msgs/BeginCommissioning", self._begin, rule=COMMISSIONING)
        self._node.offer(ANSWER, "armbridge_msgs/AnswerCommissioning", self._answer, rule=COMMISSIONING)
        self._node.offer(CANCEL, "std_srvs/Trigger", self._cancel, rule=CONFIGURING)
        self._show()

    def take_state(self, state: ArmState) -> None:
        if self._procedure is None or self._dialogue is None:
            return
        self._procedure.take_state(state, self._dialogue)
        if time.monotonic() - self._shown_at_s >= SHOWN_EVERY_S:
            self._show()

    def take_health(self, health: ArmHealth) -> None:
        self._health = health
        if self._procedure is not None:
            self._procedure.take_health(health)

    async def close(self) -> None:
        await end_task(self._task)

    def _begin(self, request: dict[str, Any]) -> str:
        if self._dialogue is not None:
            cancel = self._node.resolve(CANCEL)
            raise ServiceError(f"{self._dialogue.procedure} is in progress: answer it on the page, or call {cancel}")
        procedure = self._make(request["procedure"], request["name"])
        if self._health is not None:
            procedure.take_health(self._health)
        self._procedure, self._dialogue = procedure, Dialogue(request["procedure"], self._show)
        self._ended = Ended()
        name = f"commissioning: {request['procedure']}"
        self._task = asyncio.create_task(self._run(procedure, self._dialogue), name=name)
        # A client that looks at once must not take the last procedure's result for this one's.
        self._show()
        return f"{request['procedure']} begins: see {self._node.resolve(STATE_TOPIC)}"

    def _answer(self, request: dict[str, Any]) -> str:
        if self._dialogue is None:
            raise ServiceError(f"nothing is asked: {self._node.resolve(BEGIN)} begins a procedure")
        return self._dialogue.answer(request["step"], request["answer"])

    def _cancel(self, _request: dict[str, Any]) -> str:
        if self._dialogue is None:
            raise ServiceError("no procedure is in progress")
        self._dialogue.fail("cancelled")
        return f"{self._dialogue.procedure} is cancelled"

    async def _run(self, procedure: Procedure, dialogue: Dialogue) -> None:
        result = f"{dialogue.procedure} was ended: the server is ending"
        try:
            result = await procedure.run(dialogue)
        except RobotError as error:
            result = f"{dialogue.procedure} ended early: {error}"
        except Exception:
            result = f"{dialogue.procedure} failed; the log has the cause"
            log.exception("%s failed", dialogue.procedure)
        finally:
            with contextlib.suppress(OSError):
                procedure.close()
            log.info("%s: %s", dialogue.procedure, result)
            self._ended = Ended(result, tuple(dialogue.findings))
            self._procedure = self._dialogue = None
            self._show()

    def _show(self) -> None:
        self._shown_at_s = time.monotonic()
        message = self._message()
        if message != self._shown:
            self._shown = message
            self._node.publish(STATE_TOPIC, message)

    def _message(self) -> dict[str, Any]:
        dialogue, ended = self._dialogue, self._ended
        if dialogue is None:
            return {"findings": list(ended.findings), "result": ended.result}
        return {
            "procedure": dialogue.procedure,
            "step": dialogue.step.name,
            "instruction": dialogue.step.instruction,
            "answers": list(dialogue.step.answers),
            "progress": dialogue.progress,
            "joints": [
                {**asdict(each), "droop_rad": dialogue.droops_rad.get(each.joint, math.nan)} for each in dialogue.ranges
            ],
            "findings": list(dialogue.findings),
            "result": "",
        }
