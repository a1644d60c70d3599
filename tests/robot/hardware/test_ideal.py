import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.description import model
from robot.description.limits import JointBounds
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import RELAX_S, IdealArm
from robot.hardware.interface import Measured, run_to_end
from robot.trajectory import PERIOD_S
from tests.helpers.emulator import SteppedClock

# A rail, whose positions are metres, and a joint whose range excludes 0.
URDF = """
<robot name="gantry">
  <link name="base"/><link name="carriage"/><link name="arm"/><link name="hand"/>
  <joint name="rail" type="prismatic">
    <parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="-0.2" upper="0.6" velocity="0.25" effort="1"/>
  </joint>
  <joint name="shoulder" type="revolute">
    <parent link="carriage"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" velocity="2" effort="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="arm"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit lower="0.4" upper="2.5" velocity="2" effort="1"/>
  </joint>
</robot>
"""
SRDF = '<robot name="gantry"><group name="arm"><chain base_link="base" tip_link="hand"/></group></robot>'
ROBOT = model.parse(URDF, SRDF)
NAMES = IdealConfig().joint_names(ROBOT)
BOUNDS = JointBounds.of(ROBOT, NAMES)
RAIL, SHOULDER = 0, 1
REST = np.array([0.0, 0.0, 0.4])


class IdealRig:
    """An ideal arm that holds, and its clock."""

    def __init__(self, **settings: object) -> None:
        self.clock = SteppedClock()
        self.arm = IdealArm(IdealConfig(**{"driven": True, **settings}), NAMES, BOUNDS, self.clock)  # type: ignore[arg-type]

    def read(self, after_s: float = 0.0) -> Measured:
        """The reading after so long a tick."""
        self.clock.advance(after_s)
        return self.arm.read()

    def run(self, seconds: float) -> Measured:
        """The reading after ticks of the usual length."""
        for _ in range(round(seconds / PERIOD_S)):
            self.read(PERIOD_S)
        return self.read()


def goals(**joints: float) -> np.ndarray:
    return np.array([joints.get(name, rest) for name, rest in zip(NAMES, REST, strict=True)])


def test_a_joint_starts_where_it_is_put_within_its_limits() -> None:
    for start_rad, stands_rad in (
        ({"rail": 0.3, "elbow": 1.0}, [0.3, 0.0, 1.0]),
        ({}, [0.0, 0.0, 0.4]),
        ({"rail": -3.0, "shoulder": 9.0, "elbow": 0.0}, [-0.2, 1.5, 0.4]),
    ):
        assert IdealRig(start_rad=start_rad).read().position_rad == pytest.approx(stands_rad), start_rad


@given(st.lists(st.floats(min_value=1e-4, max_value=0.05), min_size=1, max_size=20))
def test_the_lag_does_not_depend_on_the_length_of_the_ticks(ticks_s: list[float]) -> None:
    rig = IdealRig(lag_s=0.05)
    rig.arm.write_goals(goals(shoulder=1e-3))
    for tick_s in ticks_s:
        rig.read(tick_s)
    assert rig.read().position_rad[SHOULDER] == pytest.approx(1e-3 * -math.expm1(-sum(ticks_s) / 0.05))


@pytest.mark.parametrize(("joint", "goal", "most"), [("rail", 0.6, 0.25), ("shoulder", 1.5, 2.0)])
def test_no_joint_is_faster_than_its_velocity_limit(joint: str, goal: float, most: float) -> None:
    rig = IdealRig(lag_s=0.0)
    rig.arm.write_goals(goals(**{joint: goal}))
    measured = rig.read(PERIOD_S)
    assert measured.position_rad[NAMES.index(joint)] == pytest.approx(most * PERIOD_S)
    assert measured.velocity_rad_s[NAMES.index(joint)] == pytest.approx(most)


@pytest.mark.parametrize(("driven", "goal_rad"), [(True, [0.0, 0.3, 0.4]), (False, [math.nan] * 3)])
def test_a_survey_finds_an_arm_that_holds_with_goals_or_relaxed(driven: bool, goal_rad: list[float]) -> None:
    rig = IdealRig(start_rad={"shoulder": 0.3}, driven=driven)
    found = run_to_end(rig.arm.survey())
    assert found.driven.tolist() == [driven] * 3
    assert found.goal_rad == pytest.approx(goal_rad, nan_ok=True)
    assert found.bounds is BOUNDS
    measured = rig.read()
    assert (measured.age_s.tolist(), measured.status.tolist()) == ([0.0] * 3, [0] * 3)
    for column in (measured.current_a, measured.voltage_v, measured.temperature_c):
        assert np.isnan(column).all()


def test_an_enabled_arm_holds_where_it_is_and_a_joint_that_holds_keeps_its_goal_when_others_are_enabled() -> None:
    rig = IdealRig(driven=False, start_rad={"shoulder": 0.3})
    written = goals(shoulder=1.0)
    rig.arm.write_goals(written)
    assert run_to_end(rig.arm.enable(range(3)), rig.clock.advance) == pytest.approx([0.0, 0.3, 0.4])
    assert written[SHOULDER] == 1.0
    assert rig.run(0.5).position_rad == pytest.approx([0.0, 0.3, 0.4])
    assert run_to_end(rig.arm.driven()).tolist() == [True] * 3
    run_to_end(rig.arm.switch_off([RAIL]))
    rig.arm.write_goals(goals(rail=0.5, shoulder=0.2))
    assert run_to_end(rig.arm.enable(range(3))) == pytest.approx([0.0, 0.2, 0.4])


def test_relaxing_takes_a_while_and_leaves_no_torque_unless_it_is_given_up() -> None:
    rig = IdealRig()
    steps = rig.arm.relax(np.ones(3))
    next(steps)
    steps.close()
    assert run_to_end(rig.arm.driven()).tolist() == [True] * 3
    started_s = rig.clock()
    assert run_to_end(rig.arm.relax(np.ones(3)), rig.clock.advance) == []
    assert rig.clock() - started_s == pytest.approx(RELAX_S)
    assert run_to_end(rig.arm.driven()).tolist() == [False] * 3


def test_torque_is_cut_with_the_first_step_and_the_arm_is_still_there_when_it_is_opened_again() -> None:
    rig = IdealRig()
    rig.arm.write_goals(goals(shoulder=1.0))
    rig.read(PERIOD_S)
    next(rig.arm.cut_torque())
    before = rig.read().position_rad.tolist()
    assert before[SHOULDER] > 0.0
    assert rig.run(0.2).position_rad.tolist() == before
    rig.arm.close()
    assert rig.read().position_rad.tolist() == before
