"""Handle on one planner process: deadlines, and what goes over its channel."""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any, Self

import numpy as np
import pytest
import pytest_asyncio
from hypothesis import given
from hypothesis import strategies as st

from harness.waiting import given_up
from planners import messages, pool
from planners.messages import OBJECT_BYTES, PART_BYTES, Answered, Ask, LoadRobot, NewScene, StillSearching, parts
from planners.pool import CANCEL_TIMEOUT_S, WorkerProcess
from planners.problem import MoveItErrorCode, Request
from planners.scene import EMPTY_SCENE, Box, Mesh, Pose, Scene, SceneObject
from tests.helpers.fake_workers import PLAN, SOUND, TIMED_OUT
from tests.helpers.motions import EASY, STATE
from tests.helpers.robots import so101
from tests.planners.scenes import boxes

pytestmark = pytest.mark.stepped_time


class FakeChild:
    """A child process that takes what it is sent."""

    pid, running, ending = 1, True, "SIGSEGV"

    def __init__(self, _started: object, on_message: Callable[[Any], None], on_exit: Callable[[], None], **_: Any):
        self.receives, self.exits = on_message, on_exit
        self.sent: list[Any] = []
        self.too_large = False
        self.killed = False

    async def connect(self) -> None:
        pass

    def send(self, message: object) -> None:
        if self.too_large:
            raise ValueError("a message of 9 bytes is over the limit of 8")
        self.sent.append(message)

    async def wait(self, timeout_s: float) -> None:
        pass

    async def kill(self) -> None:
        self.killed = True

    @property
    def number(self) -> int:
        """Number of the last request."""
        return next(message.number for message in reversed(self.sent) if isinstance(message, Ask))

    def answers(self, answer: object) -> None:
        """Answer the last request."""
        self.receives(Answered(self.number, answer, ending=False))


class Worked:
    """A worker whose child is fake, and its requests."""

    def __init__(self) -> None:
        self.worker = WorkerProcess(None, LoadRobot(so101(), 1 << 30), lambda _worker, _refusal: None, lambda _: None)
        self.child: Any = self.worker._child
        self.hard_s: list[float] = []

    async def started(self) -> Self:
        """Load the robot."""
        await self.worker.start()
        assert self.sent == [messages.LoadRobot]
        assert not self.worker.usable
        self.child.receives(messages.Loaded())
        assert self.worker.usable
        return self

    async def asked(self, request: Request = STATE, scene: Scene = EMPTY_SCENE) -> asyncio.Task[Any]:
        """Ask; what this sends has been sent then."""
        asking = asyncio.create_task(self.worker.ask(request, scene, self.hard_s.append))
        await asyncio.sleep(0.001)
        return asking

    @property
    def sent(self) -> list[type]:
        """Kinds of the messages since the last look."""
        kinds = [type(message) for message in self.child.sent]
        self.child.sent.clear()
        return kinds


@pytest_asyncio.fixture
async def worked(monkeypatch: pytest.MonkeyPatch) -> Worked:
    """A worker that has loaded its robot."""
    monkeypatch.setattr(pool, "Child", FakeChild)
    return await Worked().started()


async def test_a_scene_given_up_half_way_is_sent_again_and_a_request_too_large_harms_nothing(worked: Worked) -> None:
    worked.child.too_large = True
    answer = await worked.worker.ask(STATE, Scene(4))
    assert "over the limit of 8" in answer.message
    worked.child.too_large = False
    asking = await worked.asked(STATE, Scene(4))
    assert worked.sent == [NewScene, Ask]
    worked.worker._resolve(SOUND)
    assert await asking is SOUND
    large = Scene(3, boxes(600))
    asking = asyncio.create_task(worked.worker.ask(STATE, large))
    await asyncio.sleep(0)
    await given_up(asking)
    await worked.worker.cancel()
    assert worked.sent == [NewScene]
    assert not worked.worker.has(large)
    await worked.asked(STATE, large)
    sent = worked.sent
    assert (sent[0], sent[-1], len(sent)) == (NewScene, Ask, 2 + len(list(parts(large.objects))))


async def test_a_worker_that_answers_nonsense_or_ends_gets_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "Child", FakeChild)
    for ends, words in (
        (lambda child: child.answers(SOUND), "answered a PlanningProblem with StateAnswer"),
        (lambda child: child.answers("yes"), "with str"),
        (lambda child: child.exits(), "the planner process ended (SIGSEGV) while it worked on this"),
    ):
        worked = await Worked().started()
        asking = await worked.asked(EASY)
        ends(worked.child)
        failure = await asking
        assert failure.code is MoveItErrorCode.CRASH
        assert words in failure.message
        assert not worked.worker.usable


async def test_what_comes_for_an_earlier_request_counts_for_none(worked: Worked) -> None:
    await given_up(await worked.asked(EASY))
    earlier = worked.child.number
    asking = await worked.asked(EASY)
    for message in (StillSearching(earlier, 0.1), Answered(earlier, TIMED_OUT), StillSearching(earlier + 1, 0.2)):
        worked.child.receives(message)
    worked.child.answers(PLAN)
    assert await asking is PLAN
    assert worked.hard_s == [0.2]


@pytest.mark.parametrize(("after_s", "killed"), [(0.5 * CANCEL_TIMEOUT_S, False), (2.0 * CANCEL_TIMEOUT_S, True)])
async def test_a_cancelled_worker_is_ended_unless_it_answers_soon(worked: Worked, after_s: float, killed: bool) -> None:
    await given_up(await worked.asked(EASY))
    asyncio.get_running_loop().call_later(after_s, lambda: worked.child.answers(TIMED_OUT))
    await worked.worker.cancel()
    assert worked.sent[-1] is messages.Cancel
    assert (worked.child.killed, worked.worker.usable) == (killed, not killed)


async def test_a_scene_arrives_as_it_was_and_is_sent_once() -> None:
    receiver, sent = messages.SceneReceiver(), []
    sender = messages.SceneSender(sent.append, partial(asyncio.sleep, 0))
    for scene, count in ((Scene(1, boxes(600)), 6), (Scene(1, boxes(600)), 0), (Scene(2, boxes(1)), 2)):
        sent.clear()
        await sender.send(scene)
        assert len(sent) == count
        for message in sent:
            receiver.take(message)
        assert receiver.scene() == scene


meshes = st.integers(0, 3 * PART_BYTES // 24).map(
    lambda vertices: Mesh(np.zeros((vertices, 3)), np.zeros((0, 3), dtype=np.int32))
)


@given(st.lists(st.one_of(meshes, st.just(Box((1.0, 1.0, 1.0)))), max_size=20))
async def test_parts_hold_all_objects_in_order_and_none_could_do_with_fewer(shapes: list[Mesh | Box]) -> None:
    objects = tuple(SceneObject(str(i), ((shape, Pose()),)) for i, shape in enumerate(shapes))
    divided = list(parts(objects))
    assert tuple(each for part in divided for each in part) == objects
    for part in divided:
        shapes = [shape for each in part for shape, _ in each.shapes]
        sizes = [OBJECT_BYTES + (shape.vertices_m.nbytes if isinstance(shape, Mesh) else 0) for shape in shapes]
        assert sum(sizes[:-1]) < PART_BYTES
