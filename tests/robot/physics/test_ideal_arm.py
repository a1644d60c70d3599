from typing import Any

import numpy as np
import pytest

from robot.control.loop import hardware_opener
from robot.description import robot_folder
from robot.hardware.config import IdealConfig
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import HardwareInterface, run_to_end
from robot.messages import ArmConfig
from robot.physics.ideal_arm import PhysicalArm
from tests.helpers.emulator import SteppedClock


def opened(name: str, clock: SteppedClock, **settings: Any) -> HardwareInterface:
    return hardware_opener(ArmConfig(robot_folder.built_in(name).model, IdealConfig(**settings)), clock)()


@pytest.mark.parametrize("name", ["fetch", "so101"])
def test_joints_follow_their_goals_as_without_physics(name: str) -> None:
    clock = SteppedClock()
    light, physical = opened(name, clock), opened(name, clock, physics=True)
    assert (type(light), type(physical)) == (IdealArm, PhysicalArm)
    count = len(light.joint_names)
    joints = robot_folder.built_in(name).model.joints
    upper = np.array([joints[each].upper for each in light.joint_names])
    goals = {arm: run_to_end(arm.enable(range(count)), clock.advance).copy() for arm in (light, physical)}
    for tick in range(400):
        clock.advance(0.01)
        for arm in (light, physical):
            arm.write_goals(np.minimum(goals[arm] + min(tick, 100) * 0.002, upper))
            arm.read()
    expected, measured = light.read(), physical.read()
    assert measured.position_rad == pytest.approx(expected.position_rad, abs=0.01)
    assert np.abs(measured.velocity_rad_s) == pytest.approx(0.0, abs=0.02)


def test_relaxed_joints_stay_since_the_arm_carries_its_weight() -> None:
    clock = SteppedClock()
    arm = opened("so101", clock, physics=True, start_rad={"shoulder_lift": 0.9, "elbow_flex": -0.6})
    for _ in range(200):
        clock.advance(0.01)
        measured = arm.read()
    assert measured.position_rad[1] == pytest.approx(0.9, abs=0.01)
