"""Chunks on the topic and the action: followed, joined, refused and held before contact.

Server, supervisor and controller are the real ones, in stepped time; the joints are ideal.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from planners.problem import MoveItErrorCode
from robot.trajectory import PERIOD_S, Vector
from server.chunks.action_chunks import ACTION_TYPE, MAX_JUMP_RAD, PAUSE_S, SETTLES_S, PolicyPhase
from server.execution.executor import CHECKS_AHEAD
from server.execution.motions import SENDINGS_S
from server.graph.permissions import Node
from tests.helpers import stage as stage_module
from tests.helpers.arm_rig import BOUNDS, NAMES
from tests.helpers.fake_arm import HOME
from tests.helpers.graph import listen
from tests.helpers.messages import time_message
from tests.helpers.stage import ARM_JOINTS, COLUMNS, RecordedStage, inline_threads

pytestmark = pytest.mark.stepped_time

GRIPPER = NAMES.index("gripper")
HZ = 30.0
FAR_S = 1_000.0
NAME, TYPE = "/arm/chunks", "armbridge_msgs/ActionChunk"
PAUSE, RESUME, STOP = (f"{NAME}/{service}" for service in ("pause", "resume", "stop"))


def chunk(
    positions_rad: Any, names: tuple[str, ...] = ARM_JOINTS, stamp_s: float = 0.0, **fields: Any
) -> dict[str, Any]:
    """Return a chunk of targets at 30 Hz, the first a period after its stamp."""
    points = [
        {"positions": list(row), "time_from_start": time_message((index + 1) / HZ)}
        for index, row in enumerate(np.asarray(positions_rad).tolist())
    ]
    header = {"stamp": time_message(stamp_s)}
    return {"trajectory": {"header": header, "joint_names": list(names), "points": points}, **fields}


def ramp(count: int = 30, to_rad: float = 0.4, from_rad: float = 0.0) -> Vector:
    """Return targets of the arm's joints: the first one moves, the others stand."""
    targets = np.zeros((count, len(ARM_JOINTS)))
    targets[:, 0] = np.linspace(from_rad, to_rad, count)
    return targets


class Policy(RecordedStage):
    """Policy that publishes chunks; ``answers`` are to them."""

    def __init__(self) -> None:
        super().__init__()
        self.answers = listen(self.stage.graph, f"{NAME}/answer")
        self.states = listen(self.stage.graph, f"{NAME}/state")
        self.hand = Node("hand", remote=True)

    def publish(self, message: dict[str, Any], sender: Node | None = None) -> None:
        """Publish a chunk, as in a frame that arrives now."""
        self.publish_now(NAME, TYPE, message, sender)

    @property
    def phase(self) -> str:
        """Phase of the policy, by the topic."""
        phase: str = self.states[-1]["values"][0]["value"]
        return phase

    @property
    def here_rad(self) -> float:
        """Goal of the first joint [rad]."""
        return float(self.goals_rad[-1][COLUMNS[0]]) if self.goals_rad else 0.0

    async def send(self, seconds: float, message: dict[str, Any], sender: Node | None = None) -> None:
        """Publish a chunk, and let time pass."""
        self.publish(message, sender)
        await asyncio.sleep(seconds)

    async def stream(self, duration_s: float) -> None:
        """Send chunks from where the arm is, every 0.2 s."""
        for _ in range(round(duration_s / 0.2)):
            await self.send(0.2, chunk(ramp(24, self.here_rad + 0.3, self.here_rad)))

    async def jog(self, velocity: float, duration_s: float) -> None:
        """Steer the first joint by the hand's stick, and let go."""
        for each in [velocity] * round(duration_s / 0.02) + [0.0]:
            command = {"joint_names": ["shoulder_pan"], "velocities": [each], "displacements": [], "duration": 0.0}
            self.publish_now("/servo_node/delta_joint_cmds", "control_msgs/JointJog", command, self.hand)
            await asyncio.sleep(0.02)

    @property
    def codes(self) -> list[int]:
        return [answer["error_code"]["val"] for answer in self.answers]


@pytest.fixture
async def policy(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Policy]:
    inline_threads(monkeypatch)
    loop = asyncio.get_running_loop()
    # The wall clock goes with that of the arm.
    monkeypatch.setattr(time, "time", lambda: FAR_S + loop.time())
    async for made in Policy().run():
        yield made


def now_s() -> float:
    return FAR_S + asyncio.get_running_loop().time()


async def test_a_chunk_is_answered_at_once_and_followed_to_its_end(policy: Policy) -> None:
    await policy.send(0.2, chunk(ramp(), id="first"))
    (answer,) = policy.answers
    assert (answer["id"], answer["refused_from"], policy.codes) == ("first", -1, [MoveItErrorCode.SUCCESS])
    assert answer["change"] < 0.1
    until = answer["followed_until"]
    assert until["sec"] + 1e-9 * until["nanosec"] == pytest.approx(FAR_S + 0.1 + 1.0, abs=0.02)
    await asyncio.sleep(1.5)
    np.testing.assert_allclose(policy.arm_rad[-1], ramp()[-1], atol=1e-5)
    policy.assert_within_limits()
    assert len(policy.answers) == 1


@pytest.mark.parametrize("takes_along", [True, False])
async def test_a_chunk_ends_when_its_client_leaves_if_that_takes_its_goals_along(
    policy: Policy, takes_along: bool
) -> None:
    client = Node("policy", remote=True, takes_goals_along=takes_along)
    await policy.send(0.5, chunk(ramp()), client)
    policy.stage.graph.remove(client)
    await asyncio.sleep(1.5)
    assert (policy.here_rad < 0.3) is takes_along
    assert policy.phase == PolicyPhase.IDLE
    policy.assert_within_limits()


class Joining(NamedTuple):
    blend: str = ""
    wobble_rad: float = 0.0
    planning_s: float = 0.02
    slowest_rad_s: float = 0.2
    from_tick: int = 100


JOININGS = [Joining(blend, 0.01, slowest_rad_s=0.1, from_tick=60) for blend in ("", "ensemble", "real_time")]


@pytest.mark.parametrize("joining", [*JOININGS, Joining(planning_s=0.06), Joining(planning_s=0.2)])
async def test_overlapping_chunks_are_joined_without_a_stop_or_a_jump_in_one_line_of_the_log(
    policy: Policy, joining: Joining, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    monkeypatch.setattr(stage_module, "PLANNING_S", joining.planning_s)
    for number in range(10):
        begins_rad = 0.15 * number + (joining.wobble_rad if number % 2 else -joining.wobble_rad)
        await policy.send(0.3, chunk(ramp(24, begins_rad + 0.4, begins_rad), blend=joining.blend, weight=0.5))
    assert set(policy.codes) == {MoveItErrorCode.SUCCESS}
    assert len(policy.answers) == 10
    policy.assert_within_limits()
    assert (policy.velocity_rad_s[joining.from_tick : 279, 0] > joining.slowest_rad_s).all()
    await asyncio.sleep(1.5)
    assert [NAME in each.getMessage() for each in caplog.records].count(True) == 1


async def test_each_of_many_chunks_at_once_has_one_answer(policy: Policy) -> None:
    for number in range(30):
        await policy.send(0.001, chunk(ramp(), id=str(number)))
    await asyncio.sleep(0.5)
    assert sorted(int(answer["id"]) for answer in policy.answers) == list(range(30))
    assert policy.codes.count(MoveItErrorCode.PREEMPTED) == 30 - policy.codes.count(MoveItErrorCode.SUCCESS) > 20
    policy.assert_within_limits()


@pytest.mark.parametrize("after_s", [0.2, 0.203, 0.2055, 0.208])
async def test_a_chunk_has_a_tick_s_motion_in_the_first_tick_after_its_check(policy: Policy, after_s: float) -> None:
    # The checks before tell how long one takes.
    for _ in range(5):
        await policy.send(0.2, chunk(np.zeros((60, len(ARM_JOINTS)))))
    await asyncio.sleep(after_s)
    sent_s = asyncio.get_running_loop().time()
    policy.publish(chunk(ramp()))
    changes_s = sent_s
    while policy.here_rad == 0.0:
        await asyncio.sleep(0.0005)
        changes_s = asyncio.get_running_loop().time()
    assert changes_s - sent_s <= CHECKS_AHEAD * stage_module.PLANNING_S + SENDINGS_S[0] + PERIOD_S + 0.001
    # The motion began 7 ms before the tick or earlier, with the jerk that the limits allow.
    assert policy.here_rad > 1.6e-5


async def test_targets_are_followed_at_the_times_of_their_stamp(policy: Policy) -> None:
    began_s = asyncio.get_running_loop().time()
    # The observation is 0.2 s old: the first targets are over.
    await policy.send(1.5, chunk(ramp(60, 0.8), stamp_s=now_s() - 0.2))
    wanted = np.interp(np.arange(len(policy.arm_rad)) * PERIOD_S + 0.2, np.arange(1, 61) / HZ, ramp(60, 0.8)[:, 0])
    assert began_s == pytest.approx(0.1, abs=0.02)
    assert np.abs(policy.arm_rad[100:, 0] - wanted[100:]).max() < 0.02 * 0.4


def put(index: int, positions: list[float]) -> Callable[[dict[str, Any]], None]:
    return lambda trajectory: trajectory["points"][index].update(positions=positions)


def stamped(at_s: float) -> Callable[[dict[str, Any]], None]:
    return lambda trajectory: trajectory["header"].update(stamp=time_message(FAR_S + at_s))


# Fields of the chunk, a change of its trajectory, and words of the refusal.
HOSTILE: list[tuple[dict[str, Any], Callable[[dict[str, Any]], None], str]] = [
    ({}, put(3, [float("nan"), 0, 0, 0, 0]), "points[3].positions has a value that is not a finite number"),
    ({}, put(3, [0.0, 0.0]), "points[3].positions has 2 values for 5 joints"),
    ({}, lambda each: each.update(joint_names=["hand", *ARM_JOINTS[1:]]), "unknown joint 'hand'"),
    ({}, lambda each: each["points"][2].update(time_from_start=time_message(0.01)), "must be after the time"),
    ({}, lambda each: each.update(points=[]), "points has 0 entries"),
    ({"blend": "melt"}, lambda _each: None, "blend must be one of replace, ensemble, real_time, not 'melt'"),
    ({"weight": 1.5}, lambda _each: None, "weight must be 0 to 1, not 1.5"),
    ({}, put(0, [3.0, 0, 0, 0, 0]), "target 0: it takes shoulder_pan to 3.000 rad, beyond its limits"),
    ({}, lambda each: each.update(points=each["points"] * 20), "at most 500 elements in all, got 600"),
    ({}, stamped(60.0), "header.stamp is 59.7 s in the future (limit 0.1 s)"),
    ({}, stamped(-60.0), "the last target was due 59.3 s ago"),
]


async def test_a_bad_chunk_is_refused_in_one_sentence_and_the_one_before_it_goes_on(policy: Policy) -> None:
    await policy.send(0.2, chunk(ramp()))
    for count, (fields, change, words) in enumerate(HOSTILE, 1):
        bad = chunk(ramp(), **fields)
        change(bad["trajectory"])
        policy.publish(bad)
        assert len(policy.refusals) == count, words
        assert words in policy.refusals[-1]
    await asyncio.sleep(1.5)
    np.testing.assert_allclose(policy.arm_rad[-1], ramp()[-1], atol=1e-5)


async def test_a_first_target_far_from_the_arm_is_refused_by_its_distance(policy: Policy) -> None:
    await policy.send(0.3, chunk(ramp(from_rad=0.5, to_rad=0.9)))
    assert f"0.50 rad from where it is (limit {MAX_JUMP_RAD} rad)" in policy.refusals[0]
    assert policy.codes == [MoveItErrorCode.INVALID_MOTION_PLAN]
    assert not np.diff(policy.arm_rad, axis=0).any()
    # The nearest target that works is followed.
    await policy.send(0.5, chunk([policy.answers[0]["nearest"]] * 15))
    assert policy.answers[1]["refused_from"] == -1
    assert policy.here_rad == pytest.approx(0.25, abs=0.01)


async def test_a_policy_from_where_the_arm_is_goes_on_below_a_speed_limit_that_keeps_it_behind(policy: Policy) -> None:
    policy.stage.call("/arm/set_speed_limit", speed_limit=0.05)
    await asyncio.sleep(0.1)
    for _ in range(8):
        await policy.send(0.4, chunk(ramp(45, policy.here_rad + 1.5, policy.here_rad)))
    assert policy.refusals == []
    assert policy.here_rad > 0.3


async def test_a_policy_that_goes_on_from_its_former_targets_may_be_ahead_of_an_arm_that_begins(policy: Policy) -> None:
    for begins_rad in (0.0, 0.24, 0.48):
        await policy.send(0.15, chunk(ramp(24, begins_rad + 1.3, begins_rad + 0.05)))
    assert (policy.refusals, policy.codes) == ([], [MoveItErrorCode.SUCCESS] * 3)
    assert policy.here_rad > 0.2


async def test_targets_a_little_beyond_a_limit_are_moved_to_it_and_the_answer_says_how_far(policy: Policy) -> None:
    lower, upper = BOUNDS.lower_rad[COLUMNS[0]], BOUNDS.upper_rad[COLUMNS[0]]
    assert lower < 0.0 < upper
    for begins in np.arange(0.0, upper, 0.25):
        await policy.send(0.5, chunk(ramp(15, min(begins + 0.25, upper) + 0.05, begins)))
    await asyncio.sleep(1.0)
    assert policy.arm_rad[:, 0].max() <= upper + 0.002
    assert policy.arm_rad[-1, 0] == pytest.approx(upper, abs=0.003)
    assert policy.answers[-1]["change"] >= 0.05


async def test_a_chunk_is_followed_up_to_a_target_far_beyond_a_limit(policy: Policy) -> None:
    targets = ramp()
    targets[20:, 0] = 9.0
    await policy.send(1.5, chunk(targets))
    (answer,) = policy.answers
    assert answer["refused_from"] == 20
    assert "refused from target 20: it takes shoulder_pan to 9.000 rad, beyond its limits" in answer["message"]
    held = dict(zip(answer["joint_names"], answer["nearest"], strict=True))
    assert held["shoulder_pan"] == pytest.approx(targets[19, 0], abs=1e-5)
    assert policy.arm_rad[-1, 0] == pytest.approx(held["shoulder_pan"], abs=1e-5)


async def test_a_chunk_into_an_object_is_followed_as_far_as_it_is_free_and_answered_with_where_the_arm_holds(
    policy: Policy,
) -> None:
    policy.add_walls()
    await policy.send(3.0, chunk(ramp(60, 1.4)))
    (answer,) = policy.answers
    assert answer["error_code"]["val"] == MoveItErrorCode.SUCCESS
    assert 5 < answer["refused_from"] < 60
    assert "wall" in answer["message"]
    assert "the arm holds before it" in answer["message"]
    stands_rad = policy.arm_rad[-1, 0]
    assert 0.1 < stands_rad < ramp(60, 1.4)[answer["refused_from"], 0]
    assert answer["nearest"][0] == pytest.approx(stands_rad, abs=1e-5)
    policy.assert_within_limits()
    # Of a later one nothing is free.
    # Each brings it nearer to the wall.
    while policy.codes[-1] == MoveItErrorCode.SUCCESS:
        stands_rad = policy.arm_rad[-1]
        await policy.send(1.5, chunk(ramp(10, 0.25) + stands_rad))
    refused = policy.answers[-1]
    assert (refused["refused_from"], "wall" in refused["message"]) == (0, True)
    np.testing.assert_allclose(refused["nearest"], stands_rad, atol=1e-6)
    assert (policy.arm_rad[-1] == stands_rad).all()
    await policy.send(0.5, chunk([refused["nearest"]] * 10))
    assert policy.answers[-1]["refused_from"] == -1


async def test_a_chunk_that_a_pause_ends_is_answered_with_where_the_arm_holds(policy: Policy) -> None:
    await policy.send(0.5, chunk(ramp(60, 1.4)))
    policy.stage.call(PAUSE)
    await asyncio.sleep(1.0)
    ended = policy.answers[-1]
    assert ended["error_code"]["val"] == MoveItErrorCode.PREEMPTED
    np.testing.assert_allclose(ended["nearest"], policy.arm_rad[-1], atol=1e-6)
    # It braked from the path within 0.1 s.
    assert 12 < ended["refused_from"] < 20


async def test_a_chunk_from_where_the_arm_holds_before_an_object_is_followed(policy: Policy) -> None:
    policy.add_walls()
    await policy.send(0.8, chunk(ramp(45, 2.4)))
    here = policy.arm_rad[-1, 0]
    await policy.send(1.5, chunk(ramp(30, here - 0.3, here)))
    assert policy.refusals == []
    assert policy.arm_rad[-1, 0] == pytest.approx(here - 0.3, abs=1e-3)


async def test_an_object_that_comes_into_the_way_is_not_reached(policy: Policy) -> None:
    await policy.send(0.3, chunk(ramp(60, 1.4)))
    policy.add_walls()
    await asyncio.sleep(3.0)
    # The first answer, and one that says where the arm holds now.
    assert policy.answers[0]["refused_from"] == -1
    assert policy.answers[-1]["refused_from"] > 0
    assert 0.05 < policy.arm_rad[-1, 0] < 0.6
    policy.assert_within_limits()


async def test_a_stop_ends_also_a_policy_with_a_chunk_every_two_seconds_and_holds_the_gripper(policy: Policy) -> None:
    def moved(rad: float, count: int) -> dict[str, Any]:
        """Return a chunk that moves each joint of arm and gripper so far from where it is."""
        here_rad = policy.goals_rad[-1][[*COLUMNS, GRIPPER]]
        return chunk(here_rad + np.linspace(0.0, rad, count)[:, np.newaxis], (*ARM_JOINTS, "gripper"))

    await asyncio.sleep(0.1)
    await policy.send(1.0, moved(0.5, 90))
    policy.stage.call("/arm/stop")
    await asyncio.sleep(1.0)
    stands = policy.goals_rad[-1]
    for _ in range(3):
        await policy.send(2.0, moved(0.4, 60))
    policy.stage.send(NAME, ACTION_TYPE, chunk=moved(0.4, 60))
    await asyncio.sleep(2.0)
    assert (policy.goals_rad[-1] == stands).all()
    assert "publish nothing on /arm/chunks for 5 s" in policy.refusals[-1]
    await asyncio.sleep(PAUSE_S)
    await policy.send(2.0, moved(0.2, 30))
    np.testing.assert_allclose((policy.goals_rad[-1] - stands)[[*COLUMNS, GRIPPER]], 0.2, atol=0.01)
    assert policy.goals_rad[-1][COLUMNS[0]] - stands[COLUMNS[0]] == pytest.approx(0.2, abs=1e-3)


async def test_a_second_policy_is_refused_while_the_chunks_of_the_first_are_followed(policy: Policy) -> None:
    await policy.send(0.2, chunk(ramp()))
    policy.publish(chunk(ramp(30, -0.4)), Node("other"))
    assert "the arm follows the chunks of client" in policy.refusals[0]
    await asyncio.sleep(1.5)
    np.testing.assert_allclose(policy.arm_rad[-1], ramp()[-1], atol=1e-5)
    await policy.send(1.5, chunk(ramp(30, 0.2, 0.4)), Node("other"))
    np.testing.assert_allclose(policy.arm_rad[-1], ramp(30, 0.2)[-1], atol=1e-5)


async def test_the_gripper_follows_its_targets_at_their_times_and_then_holds(policy: Policy) -> None:
    opens = np.column_stack((ramp(), np.linspace(HOME["gripper"], HOME["gripper"] + 0.5, 30)))
    await policy.send(0.6, chunk(opens, (*ARM_JOINTS, "gripper")))
    wanted = np.interp(0.6, np.arange(1, 31) / HZ, opens[:, -1])
    assert policy.goals_rad[-1][GRIPPER] == pytest.approx(wanted, abs=0.1)
    await asyncio.sleep(0.5 + SETTLES_S + 0.5)
    assert policy.goals_rad[-1][GRIPPER] == pytest.approx(HOME["gripper"] + 0.5, abs=0.01)
    np.testing.assert_allclose(policy.arm_rad[-1], ramp()[-1], atol=1e-5)


@pytest.mark.parametrize("service", [PAUSE, STOP, "its client leaves"])
async def test_a_gripper_that_is_behind_the_arm_s_end_stops_with_the_policy(policy: Policy, service: str) -> None:
    far = np.column_stack((ramp(6, 0.0), np.full(6, HOME["gripper"] + 1.2)))
    client = Node("policy", remote=True, takes_goals_along=True)
    await policy.send(0.35, chunk(far, (*ARM_JOINTS, "gripper")), client)
    if service in (PAUSE, STOP):
        policy.stage.call(service)
    else:
        policy.stage.graph.remove(client)
    await asyncio.sleep(0.3)
    stands = policy.goals_rad[-1][GRIPPER]
    await asyncio.sleep(SETTLES_S)
    assert policy.goals_rad[-1][GRIPPER] == stands < HOME["gripper"] + 1.1


async def test_the_action_gives_the_answer_as_feedback_and_its_end_as_result(policy: Policy) -> None:
    feedback: list[dict[str, Any]] = []
    policy.stage.graph.actions.send_goal(
        policy.stage.client,
        NAME,
        ACTION_TYPE,
        {"chunk": chunk(ramp(), id="one")},
        policy.stage.answers.append,
        on_feedback=feedback.append,
    )
    await asyncio.sleep(2.0)
    assert [each["answer"]["id"] for each in feedback] == ["one"]
    (result,) = policy.stage.answers
    assert result.values["answer"]["error_code"]["val"] == MoveItErrorCode.SUCCESS
    np.testing.assert_allclose(policy.arm_rad[-1], ramp()[-1], atol=1e-5)


async def take_by_stick(policy: Policy) -> None:
    begins_rad = policy.here_rad
    await policy.jog(-1.0, 0.6)
    assert policy.here_rad < begins_rad - 0.1


async def take_by_leader(policy: Policy) -> None:
    """Lead the first joint to -0.25 rad, though the policy goes on to send."""
    for number in range(80):
        if number == 5:
            policy.stage.call("/teleop/start", leader="/glove")
        at_s = 0.02 * number
        sample = {"header": {"stamp": time_message(5.0 + at_s)}, "name": ["shoulder_pan"], "position": [-0.25]}
        policy.publish_now("/glove", "sensor_msgs/JointState", sample, policy.hand)
        await asyncio.sleep(0.02)
    assert policy.here_rad == pytest.approx(-0.25, abs=0.05)
    policy.stage.call("/teleop/stop")


def take_by(service: str) -> Callable[[Policy], Awaitable[None]]:
    async def take(policy: Policy) -> None:
        policy.stage.call(service)

    return take


BY_HAND, STOPPED = (
    "steering by hand has taken over: the policy goes on after",
    "the arm was stopped: publish nothing on",
)
# How the arm is taken from the policy, the phase then, words of the refusals, and if a resumption gives it back.
TAKINGS: dict[str, tuple[Callable[[Policy], Awaitable[None]], PolicyPhase, str, bool]] = {
    "a stick steers": (
        take_by_stick,
        PolicyPhase.TAKEN_OVER,
        "steering by hand has taken over: the policy goes on",
        True,
    ),
    "a leader leads": (
        take_by_leader,
        PolicyPhase.TAKEN_OVER,
        "the leader /glove has taken over: the policy goes on",
        True,
    ),
    "the policy is paused": (take_by(PAUSE), PolicyPhase.PAUSED, "the policy is paused", True),
    "the policy is stopped": (take_by(STOP), PolicyPhase.IDLE, STOPPED, False),
    "the arm is stopped": (take_by("/arm/stop"), PolicyPhase.IDLE, STOPPED, False),
}


@pytest.mark.parametrize("after_s", np.arange(0.0, 0.2, 0.067).tolist())
@pytest.mark.parametrize(("take", "phase", "words", "returns"), TAKINGS.values(), ids=TAKINGS)
async def test_an_arm_taken_from_its_policy_at_any_moment_is_not_moved_by_it_before_it_is_given_back(
    policy: Policy,
    take: Callable[[Policy], Awaitable[None]],
    phase: PolicyPhase,
    words: str,
    returns: bool,
    after_s: float,
) -> None:
    streaming = asyncio.create_task(policy.stream(4.0))
    await asyncio.sleep(0.5 + after_s)
    await take(policy)
    await asyncio.sleep(0.6)
    stands = policy.goals_rad[-1]
    await asyncio.sleep(0.6)
    streaming.cancel()
    assert (policy.goals_rad[-1] == stands).all()
    assert policy.phase == phase
    assert words in policy.refusals[-1]
    policy.stage.call(RESUME)
    await policy.stream(0.6)
    assert bool(policy.here_rad > stands[COLUMNS[0]] + 0.05) is returns
    assert returns or words in policy.refusals[-1]
    policy.assert_within_limits()


@pytest.mark.parametrize(("streams_s", "velocity"), [(0.0, 0.5), (0.6, 0.0)])
async def test_a_stick_at_rest_or_alone_takes_nothing_over(policy: Policy, streams_s: float, velocity: float) -> None:
    await policy.stream(streams_s)
    await policy.jog(velocity, 0.3)
    await asyncio.sleep(0.5)
    await policy.send(0.4, chunk(ramp(24, policy.here_rad + 0.3, policy.here_rad)))
    assert policy.phase == PolicyPhase.FOLLOWING


@pytest.mark.parametrize("hand", ["a stick", "a leader"])
async def test_a_person_who_moves_the_arm_when_a_policy_s_first_chunk_comes_goes_on(policy: Policy, hand: str) -> None:
    moving = asyncio.create_task(policy.jog(-0.3, 3.0) if hand == "a stick" else take_by_leader(policy))
    await asyncio.sleep(1.0)
    before_rad = policy.here_rad
    for _ in range(2):
        await policy.send(0.25, chunk(ramp(24, policy.here_rad + 0.3, policy.here_rad)))
        assert policy.phase == PolicyPhase.TAKEN_OVER
        assert "has taken over: the policy goes on after" in policy.refusals[-1]
    moved_rad = policy.here_rad - before_rad
    assert moved_rad == pytest.approx(-0.075 if hand == "a stick" else 0.0, abs=0.02)
    # A resumption gives the arm to the policy, also from a leader that goes on to lead.
    await asyncio.sleep(0.0 if hand == "a leader" else 2.0)
    policy.stage.call(RESUME)
    await policy.send(0.3, chunk(ramp(24, policy.here_rad + 0.3, policy.here_rad)))
    assert policy.phase == PolicyPhase.FOLLOWING
    moving.cancel()


async def test_a_chunk_of_an_observation_from_before_the_resumption_is_refused(policy: Policy) -> None:
    observed_s = now_s()
    policy.stage.call(PAUSE)
    await asyncio.sleep(0.3)
    policy.stage.call(RESUME)
    policy.publish(chunk(ramp(60), stamp_s=observed_s))
    assert "is from before the policy was resumed" in policy.refusals[-1]
    await policy.send(0.3, chunk(ramp(60), stamp_s=now_s()))
    assert policy.phase == PolicyPhase.FOLLOWING


async def test_a_wall_clock_that_is_set_back_refuses_no_chunk(policy: Policy, monkeypatch: pytest.MonkeyPatch) -> None:
    await asyncio.sleep(0.1)
    policy.stage.call(RESUME)
    loop = asyncio.get_running_loop()
    monkeypatch.setattr(time, "time", lambda: FAR_S - 100.0 + loop.time())
    await asyncio.sleep(0.1)
    await policy.send(0.3, chunk(ramp(60), stamp_s=time.time()))
    assert policy.phase == PolicyPhase.FOLLOWING


async def test_a_stick_in_the_pause_between_two_chunks_takes_over_too(policy: Policy) -> None:
    await policy.send(1.5, chunk(ramp(10, 0.1)))
    await policy.jog(-0.5, 0.3)
    assert policy.phase == PolicyPhase.TAKEN_OVER
    policy.publish(chunk(ramp(24, policy.here_rad + 0.3, policy.here_rad)))
    assert "has taken over" in policy.refusals[-1]
