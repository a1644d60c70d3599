"""The reasons themselves are shown by the controller's tests; here is what must be accepted."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robot.description.limits import JointBounds
from robot.hardware.config import IdealConfig
from robot.messages import ArmConfig, GuardLimits, checked
from robot.trajectory import Trajectory, refusal, rest_to_rest
from tests.helpers.arm_rig import NAMES
from tests.helpers.motions import smooth_move
from tests.helpers.robots import so101

CONFIG = ArmConfig(so101(), IdealConfig())
ALL_RANGES = {
    each.name: each.metadata["range"] for part in (ArmConfig, GuardLimits) for each in fields(part) if each.metadata
}


def with_value(name: str, value: Any) -> ArmConfig:
    if hasattr(CONFIG, name):
        return replace(CONFIG, **{name: value})
    return replace(CONFIG, guard_limits=replace(GuardLimits(), **{name: value}))


@pytest.mark.parametrize("name", ALL_RANGES)
def test_a_number_in_its_range_is_taken_and_another_is_the_default(name: str, caplog: pytest.LogCaptureFixture) -> None:
    least, most = ALL_RANGES[name]
    for value in ALL_RANGES[name]:
        assert checked(with_value(name, value)) == with_value(name, value)
    for value in (least - 0.001, most + 0.001, float("nan"), float("inf")):
        assert checked(with_value(name, value)) == CONFIG
    assert caplog.text.count(f"{name} must be {least:g} to {most:g}") == 4


BOUNDS = JointBounds.of(so101(), NAMES)


@given(st.integers(min_value=0, max_value=5), st.booleans())
def test_a_motion_to_the_very_limit_is_accepted(joint: int, upper: bool) -> None:
    end = float((BOUNDS.upper_rad if upper else BOUNDS.lower_rad)[joint])
    move = smooth_move({NAMES[joint]: (0.0, end)}, duration_s=8.0)
    assert refusal(move, NAMES, BOUNDS, np.zeros(6)) == ""


PAN = "shoulder_pan"
UPPER = float(BOUNDS.upper_rad[0])


def curve(time_s: list[float], positions: list[float], velocities: list[float]) -> Trajectory:
    """A trajectory of the pan through some points, beside an elbow at rest."""
    rest = np.zeros(len(time_s))
    columns = (np.column_stack((rest, values)) for values in (positions, velocities, rest))
    return Trajectory(("elbow_flex", PAN), np.array(time_s), *columns)


def reason_of(trajectory: Trajectory, *, held_rad: float = 0.0, in_motion: bool = False) -> str:
    """The reason to refuse it where the arm holds the pan there."""
    return refusal(trajectory, NAMES, BOUNDS, np.array([held_rad, *[0.0] * 5]), in_motion=in_motion)


AT_REST = "s with 0.50 rad/s; it must be at rest there (tolerance 0.10 rad/s)"


@pytest.mark.parametrize(
    ("step_s", "positions", "velocities", "reason"),
    [
        (0.5, [0.0, 0.25, 0.5], [0.0, 8.0, 0.0], "move at 8.00 rad/s, above its limit of 2.10 rad/s, at 0.500 s"),
        (
            0.1,
            [0.0, 0.055, 0.11],
            [0.0, 1.1, 0.0],
            "accelerate by 11.00 rad/s^2, above its limit of 10.20 rad/s^2, at 0.000 s",
        ),
        (2.0, [0.0, 2.0, 1.0], [0.0] * 3, "go to 2.000 rad, beyond its limits -1.922 to 1.922 rad, at 2.000 s"),
        (1.0, [0.0, 0.5, 1.0], [0.5, 0.5, 0.0], f"begin at 0.000 {AT_REST}"),
        (1.0, [0.0, 0.5, 1.0], [0.0, 0.5, 0.5], f"end at 2.000 {AT_REST}"),
    ],
)
def test_a_refusal_has_the_joint_the_limit_and_the_time(
    step_s: float, positions: list[float], velocities: list[float], reason: str
) -> None:
    times_s = [step_s * number for number in range(len(positions))]
    assert reason_of(curve(times_s, positions, velocities)) == f"joint shoulder_pan would {reason}"


def test_a_start_elsewhere_is_refused_with_the_joint_that_is_farthest_away() -> None:
    elsewhere = smooth_move({"elbow_flex": (0.06, 0.5), PAN: (-0.2, 0.5)}, 2.0)
    where = "at -0.200 rad, but the arm holds it at 0.000 rad (tolerance 0.05 rad)"
    assert reason_of(elsewhere) == f"the motion starts with joint shoulder_pan {where}"


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_motion_begins_unless_it_continues_another_and_ends_with_what_the_limits_allow_in_a_tick(way: float) -> None:
    for begin, end in ((0.101, 0.0), (0.103, 0.0), (0.0, 0.101), (0.0, 0.103)):
        moving = curve([0.0, 1.0, 2.0], [0.0, way * 0.3, way * 0.6], [way * begin, way * 0.3, way * end])
        assert (reason_of(moving) == "") is (max(begin, end) == 0.101), (begin, end)
        assert (reason_of(moving, in_motion=True) == "") is (end != 0.103), (begin, end)


def test_a_motion_has_from_1_sample_to_those_of_half_an_hour() -> None:
    for samples in (0, 1, 180_000, 180_001):
        reason = reason_of(curve(*[(np.arange(samples) * factor).tolist() for factor in (0.01, 0.0, 0.0)]))
        assert (reason == "") is (samples in (1, 180_000)), samples
        assert reason in ("", f"the motion has {samples} samples; 1 to 180000 are allowed")
    one = curve([0.0], [UPPER + 0.03], [0.0])
    assert "beyond its limits -1.922 to 1.922 rad, at 0.000 s" in reason_of(one, held_rad=UPPER)


def test_a_profile_at_the_limits_is_accepted_however_it_is_sampled() -> None:
    profile = rest_to_rest(PAN, 0.0, 1.2, float(BOUNDS.max_velocity[0]), float(BOUNDS.max_acceleration[0]))
    assert reason_of(profile) == ""
    for rate_hz in (3.0, 7.0, 10.0, 31.0, 100.0):
        time_s = np.unique(np.append(np.arange(0.0, profile.duration_s, 1.0 / rate_hz), profile.duration_s))
        samples = [profile.sample(float(at_s)) for at_s in time_s]
        positions, velocities = ([float(sample[kind][0]) for sample in samples] for kind in (0, 1))
        assert reason_of(curve(time_s.tolist(), positions, velocities)) == ""


SPEEDS = st.lists(st.floats(min_value=-2.0, max_value=2.0), min_size=2, max_size=6)
WAYS = st.lists(st.floats(min_value=-0.3, max_value=0.3), min_size=7, max_size=7)


@given(SPEEDS, WAYS, st.floats(0.1, 1.0), st.sampled_from((0.0, UPPER - 0.1, 0.1 - UPPER)))
# Only a position is beyond its limit, by 0.1 mrad, or a velocity, and only between two samples.
@example([0.8, -0.8], [0.16, 0.0, -0.16], 0.4, UPPER - 0.2379)
@example([0.1, -0.6], [0.03, 0.3, -0.18], 0.6, UPPER - 0.3503)
@example([0.02, -0.1], [0.03, 0.25, -0.15], 3.0, UPPER - 0.2967)
@example([1.9, 1.9], [0.2375, 0.5092, 0.2375], 0.25, 0.0)
# Within the limits, though a span that went on, before or after, would be too fast.
@example([0.4, -1.0, 1.71, -1.89], [-0.219, 0.041, -0.014, 0.092, -0.217], 0.73, UPPER - 0.238)
@example([1.79, -1.59, -0.53, -0.2], [-0.214, -0.102, 0.063, 0.172, 0.017], 0.92, UPPER - 0.238)
def test_a_curve_is_refused_where_it_leaves_the_limits(
    speeds: list[float], ways: list[float], span_s: float, held_rad: float
) -> None:
    time_s = [span_s * number for number in range(len(speeds) + 2)]
    positions = held_rad + np.cumsum([0.0, *ways[: len(speeds) + 1]])
    trajectory = curve(time_s, positions.tolist(), [0.0, *speeds, 0.0])
    # Both ends of every span, where an acceleration is largest, and enough between them.
    corners = np.array(time_s)
    ends = (*np.nextafter(corners[1:], 0.0), *np.nextafter(corners[:-1], np.inf))
    sampled = [trajectory.sample(float(at_s)) for at_s in (*np.linspace(1e-9, corners[-1] - 1e-9, 600), *ends)]
    position, velocity, acceleration = (np.array([float(each[kind][1]) for each in sampled]) for kind in range(3))
    shares = np.array(
        [
            np.abs(position).max() / (UPPER + 0.002),
            np.abs(velocity).max() / (BOUNDS.max_velocity[0] * 1.05),
            np.abs(acceleration).max() / (BOUNDS.max_acceleration[0] * 1.7),
        ]
    )
    refused = reason_of(trajectory, held_rad=held_rad) != ""
    if shares.max() > 1.0 + 1e-6:
        assert refused
    elif shares.max() < 1.0 - 1e-4:
        assert not refused
