"""The way to the rest pose that the arm process keeps, and the last client, in a time of their own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from planners.problem import MoveItErrorCode, Plan, PlanningFailure, PlanningProblem
from planners.scene import EMPTY_SCENE, Scene
from protocol.registry import Registry
from robot.arm import Arm
from robot.messages import PARKING_TIMEOUT_S, CommandDone, EndState, Mode, Order, ParkingPlan
from server.config import ArmSettings
from server.errors import ConfigurationError
from server.execution.monitors import CurrentState
from server.execution.queue import GoalQueue
from server.features.context import ArmContext
from server.features.parking import CHECK_S, LastClient, Parking, rest_pose
from server.graph.local_graph import LocalGraph
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters, PlannerParameters
from server.moveit.requests.planning_problems import ProblemBuilder
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState
from tests.helpers.fake_arm import ROBOT, FakeArm
from tests.helpers.motions import smooth_move

pytestmark = pytest.mark.stepped_time

REST = ROBOT.named_states["arm"]["rest"]

# The keeper looks a few times within it.
LOOKS_S = 3.0 * CHECK_S


class KeepingArm(FakeArm):
    """An arm whose process keeps ways."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: list[ParkingPlan | None] = []
        self.pid = 7

    def keep_parking(self, plan: ParkingPlan | None) -> None:
        self.kept.append(plan)

    async def rest(self, timeout_s: float) -> bool:
        return timeout_s > 0.0


class World:
    """A scene, planners and a queue as the keeper sees them."""

    def __init__(self, **settings: Any) -> None:
        self.arm = KeepingArm()
        self.scene: Scene = EMPTY_SCENE
        self.idle_count = 1
        self.busy = lambda: ""
        self.duration_s = 2.0
        self.failure: PlanningFailure | None = None
        self.asked: list[PlanningProblem] = []
        self.while_planning: Callable[[], None] = lambda: None
        self._listeners: list[Callable[[], None]] = []
        self.scene_state = self.queue = self
        problems = ProblemBuilder(ROBOT, Frames(ROBOT, SceneState(ROBOT)), PlannerParameters(MoveItParameters()))
        context = SimpleNamespace(
            robot=ROBOT,
            served=SimpleNamespace(
                name="", leads=False, settings=ArmSettings.model_validate({"on_server_lost": "park", **settings})
            ),
            parameters=MoveItParameters(),
            planning=SimpleNamespace(
                problems=problems, pool=self, scene_state=self, current=CurrentState(self.arm.as_arm, ROBOT)
            ),
            goals=SimpleNamespace(queue=self),
            graph=LocalGraph(Graph(Registry.load())),
        )
        self.parking = Parking(self.arm.as_arm, cast("ArmContext", context))

    def on_change(self, callback: Callable[[], None]) -> None:
        self._listeners.append(callback)

    def change_scene(self) -> None:
        self.scene = replace(self.scene, version=self.scene.version + 1)
        for listener in self._listeners:
            listener()

    async def ask(self, problem: PlanningProblem, _scene: Scene) -> Plan | PlanningFailure:
        self.asked.append(problem)
        self.while_planning()
        if self.failure is not None:
            return self.failure
        way = {name: (problem.start_rad[name], end) for name, end in REST.items()}
        return Plan(smooth_move(way, self.duration_s), "a line", 0.0)

    async def run(self, seconds: float = LOOKS_S) -> None:
        running = asyncio.create_task(self.parking.run())
        await asyncio.sleep(seconds)
        running.cancel()
        await asyncio.wait([running])


@pytest.fixture
async def world() -> World:
    return World()


async def test_the_way_from_where_the_arm_holds_is_kept_once(world: World) -> None:
    await world.run()
    (plan,) = world.arm.kept
    assert plan is not None
    assert set(plan.held_rad) == {joint.name for joint in ROBOT.movable_joints}
    assert plan.trajectory.sample(plan.trajectory.duration_s)[0] == pytest.approx(list(REST.values()))


async def test_a_scene_that_changes_takes_the_way_back_at_once_and_has_another_planned(world: World) -> None:
    await world.run()
    world.change_scene()
    assert world.arm.kept[1:] == [None]
    await world.run()
    assert world.arm.kept[2] is not None


async def test_a_way_that_was_planned_in_a_scene_before_is_not_kept(world: World) -> None:
    world.while_planning = world.change_scene
    await world.run()
    assert world.arm.kept == []


async def test_an_arm_process_that_was_restarted_is_told_the_way_again(world: World) -> None:
    await world.run()
    world.arm.pid = 8
    await world.run()
    assert len(world.arm.kept) == 2


@pytest.mark.parametrize("mode", [Mode.MOVING, Mode.RELAXED, Mode.DISCONNECTED])
async def test_no_way_is_planned_unless_the_arm_holds(world: World, mode: Mode) -> None:
    world.arm.state = replace(world.arm.state, mode=mode)
    await world.run()
    assert world.asked == []


async def test_a_way_that_cannot_be_found_is_told_of_once(world: World, caplog: pytest.LogCaptureFixture) -> None:
    world.failure = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "a box is in the way")
    await world.run()
    assert len(world.asked) == 1
    assert caplog.text.count("a box is in the way") == 1


async def test_a_way_that_cannot_be_found_takes_the_one_before_back(world: World) -> None:
    await world.run()
    world.failure = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "a box is in the way")
    world.arm.put(shoulder_pan=0.5)
    await world.run()
    assert world.arm.kept[1:] == [None]


async def test_a_way_above_the_limit_of_the_arm_process_is_told_of(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    world.duration_s = PARKING_TIMEOUT_S + 1.0
    await world.run()
    assert "16.0 s from here, above the limit of 15 s" in caplog.text


async def test_nothing_is_planned_for_an_arm_that_is_not_parked_at_its_end() -> None:
    world = World(on_server_lost="hold")
    await world.run()
    assert world.asked == []


async def test_the_exit_waits_for_the_way_from_the_present_place() -> None:
    world = World(on_exit=EndState.PARK)
    world.arm.put(shoulder_pan=0.5)
    await world.parking.prepare_exit()
    (plan,) = world.arm.kept
    assert plan is not None
    assert plan.held_rad["shoulder_pan"] == 0.5


async def test_parking_is_refused_where_there_is_no_rest_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.features.parking.rest_pose", lambda *_: None)
    answer = await World().parking.park("/arm/park")
    assert not answer.done
    assert "name one by arm.park_state" in answer.message


def test_a_rest_pose_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(ConfigurationError, match=r"arm\.park_state: the SRDF has no state 'bed', but closed, extended"):
        rest_pose(ROBOT, ArmSettings(park_state="bed"))


def test_an_arm_whose_description_has_no_such_state_has_no_rest_pose() -> None:
    assert rest_pose(replace(ROBOT, park_state="bed"), ArmSettings()) is None


class Leaving:
    """Clients that come and go; the arm is parked or relaxed by what it is told."""

    def __init__(self, policy: str = "park", delay_s: float = 5.0) -> None:
        self.drivers: set[object] = set()
        self.busy = lambda: ""
        self.now_s = 0.0
        self.parks = True
        self.done: list[str] = []
        self.state = SimpleNamespace(mode=Mode.HOLDING)
        settings = ArmSettings.model_validate({"on_last_client": policy, "last_client_delay_s": delay_s})
        arm, queue, parking = cast("Arm", self), cast("GoalQueue", self), cast("Parking", self)
        self.last = LastClient(arm, settings, self.drivers, queue, parking, lambda: self.now_s)

    def park(self, _source: str) -> asyncio.Future[CommandDone]:
        return self._did("park", done=self.parks)

    def order(self, order: Order) -> asyncio.Future[CommandDone]:
        return self._did(order.value, done=True)

    def _did(self, what: str, *, done: bool) -> asyncio.Future[CommandDone]:
        self.done.append(what)
        future: asyncio.Future[CommandDone] = asyncio.get_running_loop().create_future()
        future.set_result(CommandDone(0, done, what))
        return future

    def due_after(self, seconds: float) -> bool:
        self.now_s += seconds
        return self.last.due()

    def come_and_go(self) -> None:
        self.drivers.add(1)
        assert not self.last.due()
        self.drivers.clear()
        assert not self.last.due()


def test_the_arm_is_seen_to_once_the_delay_after_the_last_client() -> None:
    leaving = Leaving()
    leaving.come_and_go()
    assert not leaving.due_after(4.9)
    assert leaving.due_after(0.2)
    assert not leaving.due_after(100.0)


def test_a_client_that_comes_within_the_delay_keeps_the_arm_as_it_is() -> None:
    leaving = Leaving()
    leaving.come_and_go()
    leaving.drivers.add(1)
    assert not leaving.due_after(6.0)


def test_a_goal_that_moves_is_waited_for() -> None:
    leaving = Leaving()
    leaving.come_and_go()
    leaving.busy = lambda: "a goal"
    assert not leaving.due_after(60.0)
    leaving.busy, leaving.state = lambda: "", SimpleNamespace(mode=Mode.MOVING)
    assert not leaving.due_after(60.0)
    leaving.state = SimpleNamespace(mode=Mode.HOLDING)
    assert leaving.due_after(0.0)


async def acted(leaving: Leaving) -> list[str]:
    running = asyncio.create_task(leaving.last.run())
    leaving.drivers.add(1)
    await asyncio.sleep(LOOKS_S)
    leaving.drivers.clear()
    await asyncio.sleep(LOOKS_S)
    leaving.now_s += 10.0
    await asyncio.sleep(LOOKS_S)
    running.cancel()
    await asyncio.wait([running])
    return leaving.done


@pytest.mark.parametrize(("policy", "done"), [("nothing", []), ("park", ["park"]), ("relax", ["relax"])])
async def test_the_policy_says_what_becomes_of_the_arm(policy: str, done: list[str]) -> None:
    assert await acted(Leaving(policy)) == done


async def test_an_arm_that_cannot_be_parked_is_relaxed() -> None:
    leaving = Leaving("park")
    leaving.parks = False
    assert await acted(leaving) == ["park", "relax"]
