"""The way to the rest pose that the arm process keeps, and the last client, in a time of their own."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from planners.goals import JointGoal
from planners.interface import Planners
from planners.problem import (
    ConcurrencyQuestion,
    MoveItErrorCode,
    Plan,
    PlanningFailure,
    PlanningProblem,
    RecheckAnswer,
    Request,
)
from planners.scene import Scene
from robot.arm_group import ArmGroup
from robot.description.joined import prefixed
from robot.description.model import RobotModel
from robot.description.servo_table import HardwareTable
from robot.messages import PARKING_TIMEOUT_S, CommandDone, Mode, Order, ParkingPlan
from robot.stop_epochs import STOP_EPOCHS
from server.arm.arms import ServedArm
from server.arm.setup import Description
from server.arrival import arrived_in
from server.config import ArmSettings, Settings
from server.errors import ConfigurationError
from server.execution.goal import Goal, GoalRequest, GoalState, Progress
from server.features.context import context_of
from server.features.parking import CHECK_S, ArmParking, LastClient, Parkings, rest_pose
from server.graph.topics import Graph
from tests.helpers.fake_arm import JOINTS, ROBOT, FakeArm
from tests.helpers.messages import REGISTRY
from tests.helpers.motions import smooth_move
from tests.helpers.moveit import box, diff
from tests.server.teleop.test_latency import ROBOT_PAIR, SIDES

pytestmark = pytest.mark.stepped_time

REST = ROBOT.named_states["arm"]["rest"]

# The keeper looks a few times within it.
LOOKS_S = 3.0 * CHECK_S


class KeepingArm(FakeArm):
    """An arm whose process keeps ways."""

    def __init__(self, name: str = "") -> None:
        super().__init__()
        self.name, self.pid = name, 7
        self.kept: list[ParkingPlan | None] = []
        if name:
            self.state = replace(self.state, joint_names=tuple(f"{name}_{joint}" for joint in JOINTS))

    @property
    def pids(self) -> tuple[int, ...]:
        return (self.pid,)

    @property
    def keeps(self) -> bool:
        return bool(self.kept) and self.kept[-1] is not None

    def keep_parking(self, plan: ParkingPlan | None) -> None:
        self.kept.append(plan)

    async def rest(self, timeout_s: float) -> bool:
        return timeout_s > 0.0

    async def close(self, epoch: int) -> None:
        self.parked_at_end = not self.last_stop > epoch


def described(robot: RobotModel) -> Description:
    return Description("", robot, HardwareTable(), None)


class World:
    """Arms, a scene, planners and a queue as the keeper sees them.

    Attributes:
        meets: True where the planner finds that two ways meet.
    """

    def __init__(self, sides: Sequence[str] = ("",), **settings: Any) -> None:
        self.arms = [KeepingArm(side) for side in sides]
        self.arm = self.arms[0]
        self.meets, self.idle_count = False, 1
        self.duration_s = 2.0
        self.failure: PlanningFailure | None = None
        self.asked: list[Request] = []
        self.while_planning: Callable[[], None] = lambda: None
        own = ArmSettings.model_validate({"on_server_lost": "park", **settings})
        each = [
            ServedArm(arm.name, own, described(prefixed(ROBOT, arm.name) if arm.name else ROBOT), arm.as_arm)
            for arm in self.arms
        ]
        group = ArmGroup({arm.name: (arm.as_arm, arm.state.joint_names) for arm in self.arms})
        whole = each[0] if len(sides) == 1 else ServedArm("", ArmSettings(), described(ROBOT_PAIR), group)
        self.context = context_of(Settings(), Graph(REGISTRY), (whole, each), cast("Planners", self))
        self.parkings = Parkings(self.context)

    def change_scene(self) -> None:
        added = {"collision_objects": [box(f"box {len(self.asked)}")]}
        self.context.planning.scene_state.apply_diff(diff(world=added), {})

    async def ask(self, request: Request, _scene: Scene) -> Plan | PlanningFailure | RecheckAnswer:
        self.asked.append(request)
        self.while_planning()
        if isinstance(request, ConcurrencyQuestion):
            met = PlanningFailure(MoveItErrorCode.INVALID_MOTION_PLAN, "the ways meet")
            return RecheckAnswer(met if self.meets else None, 1.0)
        assert isinstance(request, PlanningProblem)
        assert isinstance(request.goal, JointGoal)
        way = {name: (request.start_rad[name], end) for name, end in request.goal.positions_rad.items()}
        return self.failure or Plan(smooth_move(way, self.duration_s), "a line", 0.0)

    def become(self, mode: Mode) -> None:
        """Have the first arm say that this is its mode."""
        self.arm.state = replace(self.arm.state, mode=mode)
        self.parkings.on_state("", self.arm.state)

    async def run(self) -> list[bool]:
        """Return for each arm True if its process keeps a way after a while."""
        await self.parkings.start()
        await asyncio.sleep(LOOKS_S)
        await self.parkings._keeping.stop()
        return [arm.keeps for arm in self.arms]


@pytest.fixture
async def world() -> World:
    return World()


@pytest.fixture
async def two_arms() -> World:
    made = World(SIDES)
    assert await made.run() == [True, True]
    return made


@pytest.mark.parametrize("sides", [("",), SIDES])
async def test_each_arm_keeps_its_own_way_from_where_it_holds(sides: tuple[str, ...]) -> None:
    world = World(sides)
    await world.run()
    for arm in world.arms:
        (plan,) = arm.kept
        assert plan is not None
        assert set(plan.held_rad) == set(arm.state.joint_names)
        assert plan.trajectory.positions_rad[-1] == pytest.approx(list(REST.values()))


async def test_a_scene_that_changes_takes_the_way_back_at_once_and_a_new_process_is_told_the_next(world: World) -> None:
    await world.run()
    world.change_scene()
    assert world.arm.kept[1:] == [None]
    await world.run()
    assert world.arm.keeps
    world.arm.pid = 8
    await world.run()
    assert len(world.arm.kept) == 4


@pytest.mark.parametrize("settings", [{}, {"on_server_lost": "hold", "on_exit": "park"}])
async def test_a_way_that_was_planned_in_a_scene_before_is_not_kept(settings: dict[str, str]) -> None:
    world = World(**settings)
    world.while_planning = world.change_scene
    await world.run()
    await world.parkings.stop()
    assert world.arm.kept == []


@pytest.mark.parametrize(
    ("policy", "mode"),
    [("hold", Mode.HOLDING), *(("park", mode) for mode in (Mode.MOVING, Mode.RELAXED, Mode.DISCONNECTED))],
)
async def test_no_way_is_planned_unless_the_arm_is_parked_at_its_end_and_holds(policy: str, mode: Mode) -> None:
    world = World(on_server_lost=policy)
    world.become(mode)
    await world.run()
    await world.parkings.stop()
    assert world.asked == []


async def test_without_a_way_the_one_before_is_taken_back(world: World, caplog: pytest.LogCaptureFixture) -> None:
    await world.run()
    world.failure = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "a box is in the way")
    world.arm.put(shoulder_pan=0.5)
    await world.run()
    assert world.arm.kept[1:] == [None]
    assert len(world.asked) == 2
    assert caplog.text.count("a box is in the way") == 1


async def test_a_way_above_the_limit_of_the_arm_is_reported(world: World, caplog: pytest.LogCaptureFixture) -> None:
    world.duration_s = PARKING_TIMEOUT_S + 1.0
    await world.run()
    assert "16.0 s from here, above the limit of 15 s" in caplog.text


@pytest.mark.parametrize("moved_rad", [0.0, 0.5])
async def test_the_end_of_the_server_has_a_way_from_the_present_place_planned_where_none_is(moved_rad: float) -> None:
    world = World(on_server_lost="hold", on_exit="park")
    await world.run()
    world.arm.put(shoulder_pan=moved_rad)
    await world.parkings.stop()
    assert len(world.asked) == (2 if moved_rad else 1)
    plan = world.arm.kept[-1]
    assert plan is not None
    assert plan.held_rad["shoulder_pan"] == moved_rad


async def test_a_rest_pose_is_one_of_the_srdf_and_parking_is_refused_without_one(monkeypatch: Any) -> None:
    with pytest.raises(ConfigurationError, match=r"arm\.park_state: the SRDF has no state 'bed', but closed, extended"):
        rest_pose(ROBOT, ArmSettings(park_state="bed"))
    assert rest_pose(replace(ROBOT, park_state="bed"), ArmSettings()) is None
    monkeypatch.setattr("server.features.parking.rest_pose", lambda *_: None)
    answer = await World().parkings._parkings[0].park("/arm/park")
    assert not answer.done
    assert "name one by arm.park_state" in answer.message


def left_moves(two_arms: World) -> None:
    two_arms.become(Mode.MOVING)


def left_is_elsewhere(two_arms: World) -> None:
    two_arms.arm.put(shoulder_pan=0.3)
    two_arms.become(Mode.HOLDING)


def a_goal_begins(two_arms: World) -> None:
    listener = two_arms.context.goals.queue.listeners[-1]
    listener.on_progress(Goal("1", GoalRequest("/goal")), Progress(GoalState.EXECUTING, "moves"))


@pytest.mark.parametrize("happens", [left_moves, left_is_elsewhere, a_goal_begins])
async def test_no_arm_keeps_a_way_beside_an_arm_that_moves(two_arms: World, happens: Callable[[World], None]) -> None:
    happens(two_arms)
    assert [arm.keeps for arm in two_arms.arms] == [False, False]
    two_arms.become(Mode.HOLDING)
    assert await two_arms.run() == [True, True]


async def test_no_arm_keeps_a_way_where_two_ways_meet(two_arms: World, caplog: pytest.LogCaptureFixture) -> None:
    two_arms.meets = True
    left_is_elsewhere(two_arms)
    assert await two_arms.run() == [False, False]
    assert caplog.text.count("here an arm would be relaxed at its end: the ways meet") == 1


async def test_the_arm_that_has_no_way_is_named(two_arms: World, caplog: pytest.LogCaptureFixture) -> None:
    two_arms.failure = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "a wall")
    left_is_elsewhere(two_arms)
    assert await two_arms.run() == [False, False]
    assert caplog.text.count(f"here an arm would be relaxed at its end: {SIDES[0]}: a wall") == 1


async def test_a_relaxed_arm_keeps_no_way_and_the_other_arm_keeps_its_own(two_arms: World) -> None:
    two_arms.become(Mode.RELAXED)
    assert await two_arms.run() == [False, True]


async def test_the_end_of_the_server_takes_no_way_from_an_arm_that_is_parked(two_arms: World) -> None:
    await two_arms.parkings.stop()
    left_moves(two_arms)
    assert [arm.keeps for arm in two_arms.arms] == [True, True]


async def test_an_arm_that_is_stopped_while_the_one_before_it_is_parked_is_not_parked_at_the_end() -> None:
    left, right = (world := World(SIDES, on_exit="park")).arms
    stopped: Callable[[], None] = right.stop
    world.while_planning = lambda: world.asked[1:] or stopped()
    with arrived_in(STOP_EPOCHS.present):
        await world.context.goals.queue.close(1.0)
        await world.parkings.stop()
    assert [left.parked_at_end, right.parked_at_end] == [True, False]


class Leaving:
    """Clients that come and go; the arm is parked or relaxed by what it is told."""

    def __init__(self, policy: str = "park", *, parks: bool = True) -> None:
        self.drivers: set[object] = set()
        self.busy = lambda: ""
        self.now_s, self.parks, self.last_stop = 0.0, parks, 0
        self.done: list[str] = []
        self.state = SimpleNamespace(mode=Mode.HOLDING)
        settings = ArmSettings.model_validate({"on_last_client": policy, "last_client_delay_s": 5.0})
        served, goals = SimpleNamespace(settings=settings), SimpleNamespace(queue=self)
        self.arm, self.context = self, SimpleNamespace(served=served, goals=goals)
        self.last = LastClient(cast("ArmParking", self), self.drivers, lambda: self.now_s)

    def park(self, _source: str) -> asyncio.Future[CommandDone]:
        self.last_stop = STOP_EPOCHS.begin()
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

    async def leave(self) -> None:
        """Be there, and leave for longer than the delay."""
        self.drivers.add(1)
        await asyncio.sleep(LOOKS_S)
        self.drivers.clear()
        await asyncio.sleep(LOOKS_S)
        self.now_s += 10.0
        await asyncio.sleep(LOOKS_S)

    def come_and_go(self) -> None:
        self.drivers.add(1)
        assert not self.last.due()
        self.drivers.clear()
        assert not self.last.due()


def test_the_arm_is_seen_to_once_the_delay_after_the_last_client_and_after_goals_that_move() -> None:
    leaving = Leaving()
    leaving.come_and_go()
    leaving.drivers.add(1)
    assert not leaving.due_after(6.0), "a client has come within it"
    leaving.come_and_go()
    assert not leaving.due_after(4.9)
    assert leaving.due_after(0.2)
    assert not leaving.due_after(100.0)
    leaving.come_and_go()
    leaving.busy = lambda: "a goal"
    assert not leaving.due_after(60.0)
    leaving.busy, leaving.state = lambda: "", SimpleNamespace(mode=Mode.MOVING)
    assert not leaving.due_after(60.0)
    leaving.state = SimpleNamespace(mode=Mode.HOLDING)
    assert leaving.due_after(0.0)


@pytest.mark.parametrize(
    ("policy", "parks", "done"),
    [("park", True, ["park"]), ("park", False, ["park", "relax"]), ("relax", True, ["relax"])],
)
async def test_the_policy_says_what_becomes_of_the_arm(policy: str, *, parks: bool, done: list[str]) -> None:
    assert [len(World(**set_).parkings.last_clients) for set_ in ({}, {"on_last_client": policy})] == [0, 1]
    leaving = Leaving(policy, parks=parks)
    running = asyncio.create_task(leaving.last.run())
    await leaving.leave()
    running.cancel()
    await asyncio.wait([running])
    assert leaving.done == done


async def test_an_arm_that_a_viewer_stops_before_or_on_its_way_to_rest_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    leaving, parked = Leaving(), asyncio.get_running_loop().create_future()
    monkeypatch.setattr(leaving, "park", lambda _source: parked)
    running = asyncio.create_task(leaving.last.run())
    await leaving.leave()
    leaving.last_stop = STOP_EPOCHS.begin()
    parked.set_result(CommandDone(0, done=False, message="stopped by /arm/stop"))
    await asyncio.sleep(LOOKS_S)
    running.cancel()
    await asyncio.wait([running])
    assert leaving.done == []
    leaving = Leaving()
    leaving.come_and_go()
    leaving.last_stop = STOP_EPOCHS.begin()
    running = asyncio.create_task(leaving.last.run())
    leaving.now_s += 10.0
    await asyncio.sleep(LOOKS_S)
    running.cancel()
    await asyncio.wait([running])
    assert leaving.done == []
