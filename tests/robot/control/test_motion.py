import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from ruckig import ControlInterface, InputParameter, RuckigError

from robot.control.motion import Motion, Streaming, VelocityTracking, splice_refusal
from robot.description.limits import JointBounds
from robot.messages import Continuation, Execute, GuardLimits, Outcome, Stream
from robot.trajectory import TIME_TO_FULL_ACCELERATION_S, Trajectory
from tests.helpers.arm_rig import NAMES as ARM_NAMES
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

PERIOD_S = 0.01
MAX_ACCELERATION = np.array([6.0, 5.0])

# Share of it for a change of the rate, also where a joint uses all of it on the path.
BRAKING_SHARE = 0.05
MOVES = {"shoulder_pan": (0.0, 1.2), "elbow_flex": (0.5, -0.4)}


def playing(trajectory: Trajectory) -> Motion:
    unlimited = np.full(2, 100.0)
    bounds = JointBounds(-unlimited, unlimited, unlimited, MAX_ACCELERATION)
    return Motion(Execute(1, trajectory), tuple(MOVES), bounds, GuardLimits())


def play(stop_after_s: float, duration_s: float = 2.0) -> tuple[Motion, np.ndarray]:
    """Play until nothing moves; the goals of all ticks."""
    playback = playing(smooth_move(MOVES, duration_s))
    goals = [playback.step(0.0)]
    for tick in itertools.count(1):
        if tick * PERIOD_S >= stop_after_s:
            playback.stop()
        goals.append(playback.step(PERIOD_S))
        if playback.finished:
            return playback, np.array(goals)
        assert tick < 1000
    raise AssertionError


def distance_from_line(goals: np.ndarray) -> np.ndarray:
    start, end = np.array([0.0, 0.5]), np.array([1.2, -0.4])
    direction = (end - start) / np.linalg.norm(end - start)
    offset = goals - start
    return np.linalg.norm(offset - np.outer(offset @ direction, direction), axis=1)


def allowed_rad_s2(duration_s: float) -> np.ndarray:
    """The acceleration limits, and what three goals do not show: the path's jerk, 60 way / time^3, for two ticks."""
    way_rad = np.abs([end - start for start, end in MOVES.values()])
    return MAX_ACCELERATION * (1.0 + BRAKING_SHARE) + 60.0 * way_rad / duration_s**3 * 2.0 * PERIOD_S


@settings(max_examples=50)
@given(st.floats(min_value=0.0, max_value=1.95), st.floats(min_value=1.3, max_value=4.0))
def test_a_stop_stays_on_the_path_and_within_the_acceleration_limits(stop_after_s: float, duration_s: float) -> None:
    playback, goals = play(stop_after_s, duration_s)
    assert distance_from_line(goals) == pytest.approx(np.zeros(len(goals)), abs=1e-9)
    accelerations = np.abs(np.diff(goals, n=2, axis=0)) / PERIOD_S**2
    assert (accelerations <= allowed_rad_s2(duration_s)).all()
    assert playback.remaining_s >= 0.0
    # At the acceleration limits the fastest of these motions stops in 0.29 s.
    assert len(goals) * PERIOD_S - stop_after_s <= 0.32


@settings(max_examples=50)
@example([(0.75, 15), (-1.0, 4), (1.0, 3)], 1.5)
@given(st.lists(st.tuples(st.floats(-1.0, 1.0), st.integers(1, 80)), min_size=1, max_size=8), st.floats(1.3, 4.0))
def test_at_any_pace_the_arm_stays_on_the_path_within_limits(paces: list[tuple[float, int]], duration_s: float) -> None:
    playback = playing(smooth_move(MOVES, duration_s))
    goals = [playback.step(0.0)]
    for pace, ticks in paces:
        goals += [playback.step(PERIOD_S, pace) for _ in range(ticks)]
    points = np.array(goals)
    assert distance_from_line(points) == pytest.approx(np.zeros(len(points)), abs=1e-9)
    accelerations = np.abs(np.diff(points, n=2, axis=0)) / PERIOD_S**2
    assert (accelerations <= allowed_rad_s2(duration_s)).all()


def test_the_way_back_ends_at_rest_where_the_path_began_and_there_is_none_from_where_the_joints_settle() -> None:
    playback = playing(smooth_move(MOVES, 2.0))
    for _ in range(100):
        playback.step(PERIOD_S)
    goals = [playback.step(PERIOD_S, -1.0) for _ in range(200)]
    assert goals[-1] == pytest.approx([0.0, 0.5])
    assert not playback.finished
    playback.stop()
    playback.step(PERIOD_S, -1.0)
    assert (playback.finished, playback.completed) == (True, False)
    playback, settled = play(stop_after_s=99.0)
    assert playback.step(PERIOD_S, -1.0) == pytest.approx(settled[-1])
    assert playback.completed


def test_a_path_that_begins_in_motion_is_gone_back_without_a_jerk_at_its_start() -> None:
    cut = since(0.8)
    playback = playing(cut)
    for _ in range(60):
        playback.step(PERIOD_S)
    goals = np.array([playback.step(PERIOD_S, -1.0) for _ in range(300)])
    accelerations = np.abs(np.diff(goals, n=2, axis=0)) / PERIOD_S**2
    assert (accelerations <= MAX_ACCELERATION * (1.0 + BRAKING_SHARE) + 0.5).all()
    assert goals[-1] == pytest.approx(cut.positions_rad[0], abs=0.01)


NAMES = ("shoulder_pan", "elbow_flex", "gripper")
BOUNDS = JointBounds.of(so101(), NAMES)
LIMITS = GuardLimits()


def at_its_end(
    limits: GuardLimits = LIMITS, tolerance_rad: np.ndarray | None = None, **options: bool
) -> tuple[Motion, np.ndarray]:
    move = smooth_move({"elbow_flex": (0.0, 0.5), "gripper": (0.0, 1.0)}, 1.0)
    motion = Motion(Execute(1, move, **options), NAMES, BOUNDS, limits, tolerance_rad)
    motion.step(2.0)
    return motion, np.array([0.0, 0.5, 1.0])


def test_a_motion_has_reached_its_end_after_three_ticks_in_a_row_within_the_tolerance_of_its_joints() -> None:
    motion, goal = at_its_end()
    off_rad = (0.059, -0.059, 0.061, 0.059, -0.059, 0.059)
    ends = [motion.end(goal, goal + np.array([0.5, 0.0, off]), 0.01) for off in off_rad]
    assert [end is not None for end in ends] == [False] * 5 + [True]


def test_progress_and_rate_are_of_the_pace_and_of_the_fastest_while_it_waits_or_goes_back() -> None:
    playback = playing(smooth_move(MOVES, 2.0))
    for _ in range(100):
        playback.step(PERIOD_S)
    assert playback.fraction == pytest.approx(0.5)
    for pace, rate, remaining_s in ((1.0, 1.0, 1.0), (0.5, 0.5, 2.0), (0.0, 0.0, 1.0), (-0.5, 0.5, 1.0)):
        playback.step(0.0, pace)
        assert (playback.rate, playback.remaining_s) == (rate, pytest.approx(remaining_s))


@pytest.mark.parametrize(("beyond", "rate"), [(1.049, 1.0), (1.051, 1.0 / 1.051)])
def test_a_motion_beyond_the_speed_limit_by_more_than_5_percent_is_played_slower(beyond: float, rate: float) -> None:
    pan = smooth_move({"shoulder_pan": (0.0, 1.0)}, 2.0)
    speed_limit = 1.875 / 2.0 / float(BOUNDS.max_velocity[0]) / beyond
    assert Motion(Execute(1, pan), NAMES, BOUNDS, LIMITS, None, speed_limit).rate == pytest.approx(rate, rel=1e-4)


def test_a_gripper_that_stays_short_of_its_goal_has_gripped() -> None:
    motion, goal = at_its_end(gripping=True)
    motion.end(goal, goal - 0.1, 0.0)
    assert motion.end(goal, goal - 0.1, LIMITS.settle_timeout_s).outcome is Outcome.GRIPPED


def test_how_near_and_how_soon_can_be_set() -> None:
    limits = GuardLimits(goal_tolerance_rad=0.2, settle_timeout_s=3.0)
    motion, goal = at_its_end(limits)
    ends = [motion.end(goal, goal - 0.19, tick / 100) for tick in range(3)]
    assert ends[-1] is not None
    assert ends[-1].outcome is Outcome.REACHED
    # The joint that is farthest beyond its own tolerance is named.
    for tolerances_rad, name, away_rad in ((None, "gripper", 0.21), ([0.1, 0.1, 0.2], "elbow_flex", 0.15)):
        motion, goal = at_its_end(limits, None if tolerances_rad is None else np.array(tolerances_rad))
        near = goal - np.array([0.0, 0.15, 0.21])
        assert [motion.end(goal, near, now_s) for now_s in (5.0, 7.9)] == [None, None]
        wait = f"3 s after the end of the motion (tolerance {0.2 if tolerances_rad is None else 0.1} rad)"
        assert motion.end(goal, near, 8.0).message == f"joint {name} is still {away_rad:.3f} rad from its goal {wait}"


PATH = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.0, -0.5)}, 2.0)


def in_progress(gripping: bool = False) -> list[Motion | Streaming]:
    """One motion, half done."""
    motion = Motion(Execute(7, PATH, gripping), NAMES, BOUNDS, LIMITS)
    for _ in range(100):
        motion.step(0.01, 1.0, 1.0)
    return [motion]


def since(from_s: float, **changes: tuple[float, float]) -> Trajectory:
    """The same motion from a time on, or another one."""
    path = smooth_move({"shoulder_pan": (0.0, 1.0), "elbow_flex": (0.0, -0.5), **changes}, 2.0)
    kept = path.time_s >= from_s - 1e-9
    arrays = (path.positions_rad[kept], path.velocities_rad_s[kept], path.accelerations_rad_s2[kept])
    return Trajectory(path.joint_names, path.time_s[kept] - from_s, *arrays)


def asked(motions: list[Motion | Streaming], trajectory: Trajectory, number: int = 7, from_s: float = 0.9) -> str:
    command = Execute(8, trajectory, continues=Continuation(number, from_s))
    return splice_refusal(motions, command, NAMES, BOUNDS, np.array([0.5, -0.25, 0.0]))


def slower_from(at_s: float) -> Trajectory:
    """The motion since 0.9 s, but a fifth slower when it comes to a time of it, and soon at rest."""
    ends = [PATH.sample(0.9), PATH.sample(at_s)]
    positions = np.array([*(end[0] for end in ends), ends[1][0] + 0.5 * ends[1][1]])
    velocities = np.array([ends[0][1], 0.8 * ends[1][1], np.zeros(2)])
    return Trajectory(PATH.joint_names, np.array([0.0, at_s - 0.9, at_s + 0.1]), positions, velocities, 0.0 * positions)


REFUSED = {
    "no such motion": (since(0.9), 6, 0.9, "not in progress"),
    "it is past that place": (since(1.2), 7, 1.2, "no longer where"),
    "at another speed": (slower_from(1.0), 7, 0.9, "no longer where"),
    "another path": (since(0.9, elbow_flex=(0.0, 0.5)), 7, 0.9, "the motion starts with joint elbow_flex"),
    "other joints": (smooth_move({"gripper": (0.0, 1.0)}, 2.0), 7, 0.0, "other joints"),
    "beyond a limit": (smooth_move({"shoulder_pan": (0.0, 9.0), "elbow_flex": (0.0, -0.5)}, 9.0), 7, 0.0, "limits"),
}


@pytest.mark.parametrize(("trajectory", "number", "from_s", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_a_motion_that_would_jump_is_refused(trajectory: Trajectory, number: int, from_s: float, words: str) -> None:
    assert words in asked(in_progress(), trajectory, number, from_s)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motion_fits_where_it_comes_by_the_same_place_at_the_same_speed(sign: float) -> None:
    path = since(0.9)
    for by_rad, by_rad_s, fits in ((0.9e-6, 0.0, True), (1.1e-6, 0.0, False), (0.0, 9e-4, True), (0.0, 1.1e-3, False)):
        off = np.array([[0.0, sign]])
        arrays = path.positions_rad + by_rad * off, path.velocities_rad_s + by_rad_s * off, path.accelerations_rad_s2
        moved = Trajectory(path.joint_names, path.time_s, *arrays)
        assert (asked(in_progress(), moved) == "") is fits, (by_rad, by_rad_s)


def test_nothing_takes_the_place_of_a_grip_or_of_a_motion_that_brakes_and_no_grip_that_of_a_motion() -> None:
    assert "a grip" in asked(in_progress(gripping=True), since(0.9))
    grip = Execute(8, since(0.9), gripping=True, continues=Continuation(7, 0.9))
    assert "a grip" in splice_refusal(in_progress(), grip, NAMES, BOUNDS, np.zeros(3))
    motions = in_progress()
    motions[0].stop()
    assert asked(motions, since(0.9)) != ""


STREAM_BOUNDS = JointBounds(np.array([-1.0, -0.5]), np.array([1.0, 0.8]), np.array([2.0, 1.2]), np.array([6.0, 3.0]))
MAX_JERK = STREAM_BOUNDS.max_acceleration / TIME_TO_FULL_ACCELERATION_S

targets = st.lists(st.tuples(st.tuples(*[st.floats(-3.0, 3.0)] * 2), st.integers(1, 30)), min_size=1, max_size=8)


def follow(steps: list[tuple[tuple[float, float], int]], start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Positions at every tick, with a rest at the end that is long enough to stop in."""
    tracking = VelocityTracking(STREAM_BOUNDS, np.array(start))
    positions = [tracking.position_rad]
    for velocity, ticks in [*steps, ((0.0, 0.0), 150)]:
        tracking.set_target(np.array(velocity))
        positions += [tracking.advance(PERIOD_S) for _ in range(ticks)]
    assert tracking.at_rest
    return np.array(positions)


@settings(max_examples=100, deadline=None)
@given(targets)
def test_at_any_target_velocity_acceleration_and_jerk_stay_bounded_and_no_joint_leaves_its_limits(steps) -> None:
    positions = follow(steps)
    velocity, acceleration, jerk = (np.diff(positions, n, axis=0) / PERIOD_S**n for n in (1, 2, 3))
    assert (np.abs(velocity) <= STREAM_BOUNDS.max_velocity + 1e-6).all()
    assert (np.abs(acceleration) <= STREAM_BOUNDS.max_acceleration + 1e-4).all()
    assert (np.abs(jerk) <= MAX_JERK + 1e-2).all()
    assert (positions <= STREAM_BOUNDS.upper_rad + 1e-6).all()
    assert (positions >= STREAM_BOUNDS.lower_rad - 1e-6).all()


def test_a_joint_at_its_limit_waits_there_while_the_other_goes_on() -> None:
    tracking = VelocityTracking(STREAM_BOUNDS, np.zeros(2))
    tracking.set_target(np.array([0.3, 1.2]))
    for _ in range(200):
        tracking.advance(PERIOD_S)
    assert tracking.position_rad[1] == pytest.approx(0.8)
    assert tracking.velocity_rad_s == pytest.approx([0.3, 0.0], abs=1e-9)


def test_a_joint_that_stands_outside_its_limits_stays_or_comes_inside() -> None:
    assert follow([((1.0, 0.0), 50)], start=(1.1, 0.0))[:, 0].max() == pytest.approx(1.1)
    assert follow([((-1.0, 0.0), 50)], start=(1.1, 0.0))[-1, 0] < 1.0


def test_a_target_too_slow_to_see_is_rest() -> None:
    for target, moves in ((9e-4, False), (-9e-4, False), (1.1e-3, True), (-1.1e-3, True)):
        assert bool(np.abs(follow([((target, 0.0), 100)])).max()) is moves, target


def test_joints_brake_where_no_profile_is_found_to_their_limits() -> None:
    tracking = VelocityTracking(STREAM_BOUNDS, np.zeros(2))
    tracking.set_target(np.array([0.5, 0.0]))
    moving_rad = [tracking.advance(PERIOD_S)[0] for _ in range(50)][-1]
    ruckig = tracking._ruckig

    class Failing:
        def calculate(self, given: InputParameter, profile: object) -> None:
            if ControlInterface.Position in given.per_dof_control_interface:
                raise RuckigError("no solution")
            ruckig.calculate(given, profile)

    tracking._ruckig = Failing()  # type: ignore[assignment]
    tracking.set_target(np.array([0.6, 0.0]))
    positions = [tracking.advance(PERIOD_S)[0] for _ in range(50)]
    assert tracking.at_rest
    assert moving_rad < positions[-1] < moving_rad + 0.1


NOWHERE = np.zeros(6)


@pytest.fixture
def stream() -> Streaming:
    """A stream of two joints, in another order than the arm's."""
    bounds = JointBounds.of(so101(), ARM_NAMES)
    return Streaming(Stream(3, ("wrist_roll", "shoulder_pan")), ARM_NAMES, bounds, np.zeros(6))


def run(stream: Streaming, seconds: float, velocity: tuple[float, float] | None = None, rate: float = 1.0) -> None:
    for _ in range(round(seconds / PERIOD_S)):
        if velocity is not None:
            stream.steer(np.array(velocity))
        stream.step(PERIOD_S, rate, 1.0)


def test_without_setpoints_it_comes_to_rest_and_ends_unless_one_comes_while_it_brakes(stream) -> None:
    run(stream, 0.5, (0.4, -0.2))
    # Six ticks, of which the last setpoint had one.
    run(stream, 0.05)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.4, -0.2])
    run(stream, PERIOD_S)
    assert 0.0 < stream.commanded.velocity_rad_s[0] < 0.4
    assert stream.commanded.at_s == pytest.approx(0.56)
    run(stream, 0.5, (0.4, -0.2))
    assert stream.commanded.velocity_rad_s == pytest.approx([0.4, -0.2])
    run(stream, 0.6)
    assert stream.commanded.velocity_rad_s == pytest.approx([0.0, 0.0])
    ended = stream.end(NOWHERE, NOWHERE, 0.0)
    assert (ended.motion_id, ended.outcome) == (3, Outcome.UNSTEERED)
    assert "no setpoint" in ended.message


@pytest.mark.parametrize("bad", [[np.nan, 0.0], [np.inf, 0.0], [0.1], [0.1, 0.1, 0.1]])
def test_a_setpoint_that_is_none_ends_it_smoothly(stream, bad) -> None:
    run(stream, 0.5, (0.4, -0.2))
    stream.steer(np.array(bad))
    assert not stream.finished
    stream.stop()
    run(stream, 0.5)
    assert "no velocities" in stream.end(NOWHERE, NOWHERE, 0.0).message


@pytest.mark.parametrize(("rate", "share"), [(0.5, 0.5), (0.0, 0.0), (-1.0, 0.0)])
def test_a_slower_pace_slows_it_and_back_is_a_pause(stream, rate, share) -> None:
    run(stream, 0.5, (0.4, -0.2), rate)
    assert stream.commanded.velocity_rad_s == pytest.approx(share * np.array([0.4, -0.2]))
