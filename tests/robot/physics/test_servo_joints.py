"""Emulated servos in a physical world: they droop, follow, stall and relax as the light emulation's do."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm
from robot.errors import PortLost
from robot.hardware.interface import HardwareInterface, Measured, StatusFlag, run_to_end
from robot.physics.bodies import Body, BodyShape, SetBodies
from robot.physics.world import World
from tests.helpers.dynamixel import emulated_arm
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import so101

TICK_S = 0.01
LEVEL = (0.0, 0.0, 0.0, 1.0)
# Of the SO-101 and the Koch: far out, above the floor.
STRETCHED, RAISED = {"shoulder_lift": 0.9, "elbow_flex": -0.6}, {"shoulder_lift": -0.7}


@dataclass
class Driven:
    """An arm whose servos hold, and whose time a test moves on."""

    source: EmulatedArm[Any]
    hardware: HardwareInterface
    clock: SteppedClock
    goal_rad: np.ndarray

    def tick(self, ticks: int = 1) -> Measured:
        for _ in range(ticks):
            self.clock.advance(TICK_S)
            self.hardware.write_goals(self.goal_rad)
            measured = self.hardware.read()
        return measured

    def move(self, joint: int, to_rad: float, ticks: int) -> np.ndarray:
        """Move a joint at a constant speed; return the following errors, shape (ticks,)."""
        errors = []
        for position in np.linspace(self.goal_rad[joint], to_rad, ticks):
            self.goal_rad[joint] = position
            errors.append(position - self.tick().position_rad[joint])
        return np.array(errors)


# MuJoCo compiles its few boxes in a hundredth of the time of all parts.
BARE = replace(so101(), parts={})


def driven(kind: str = "feetech", robot: RobotModel = BARE, **settings: Any) -> Driven:
    clock = SteppedClock()
    source = emulated_arm(kind, clock, robot, **{"start_rad": RAISED if kind == "dynamixel" else STRETCHED, **settings})
    hardware = source.open()
    run_to_end(hardware.survey())
    return Driven(source, hardware, clock, run_to_end(hardware.enable(range(6)), clock.advance).copy())


@pytest.mark.parametrize("settings", [{}, {"population": "lerobot"}, {"kind": "dynamixel"}])
def test_droop_and_following_error_are_near_the_light_emulators(settings: dict[str, Any]) -> None:
    light, physical = (driven(physics=physics, **settings) for physics in (False, True))
    assert physical.tick(100).position_rad == pytest.approx(light.tick(100).position_rad, abs=0.004)
    errors = [arm.move(1, 0.0, 90) for arm in (physical, light)]
    # From the third tenth of a second on: the rotor's inertia is the physical arm's alone.
    assert errors[0][30:] == pytest.approx(errors[1][30:], abs=0.01)
    assert physical.tick(100).position_rad == pytest.approx(light.tick(100).position_rad, abs=0.004)
    assert physical.tick().load == pytest.approx(light.tick().load, abs=0.03)


def test_a_load_that_changes_its_side_moves_the_joint_through_the_backlash() -> None:
    way_ticks = {}
    for backlash_ticks in (None, 0.0):
        arm = driven(physics=True, start_rad={})
        servo = arm.source.bus.servos[0]
        if backlash_ticks is not None:
            servo.backlash_ticks = backlash_ticks
        ways = []
        for push_permille in (30.0, -30.0):
            servo.plant.push_permille = push_permille
            before_ticks = servo.plant.position_ticks
            for _ in range(80):
                arm.tick()
                ways.append(servo.plant.position_ticks - before_ticks)
        way_ticks[backlash_ticks] = min(ways[80:]), ways[-1]
    # The encoder is behind the gear, so the servo brings the joint back.
    assert way_ticks[None][1] == pytest.approx(way_ticks[0.0][1], abs=1.5)
    assert way_ticks[0.0][0] > -4.8
    assert way_ticks[None][0] < -5.5


def test_gravity_torques_are_pinocchios() -> None:
    robot = so101()
    model = pin.buildModelFromXML(robot.urdf)
    names = [joint.name for joint in robot.movable_joints]
    random = np.random.default_rng(7)
    world = World(robot, names, np.zeros(len(names)))
    for _ in range(20):
        position_rad = np.array([random.uniform(robot.joints[name].lower, robot.joints[name].upper) for name in names])
        world.place(position_rad)
        order = [model.names[at] for at in range(1, model.njoints)]
        q = np.array([position_rad[names.index(name)] for name in order])
        expected = dict(zip(order, pin.computeGeneralizedGravity(model, model.createData(), q), strict=True))
        assert world.load_nm == pytest.approx([expected[name] for name in names], abs=1e-6)


def test_a_joint_before_an_obstacle_stalls_until_the_servo_protects_itself() -> None:
    arm = driven(physics=True, start_rad={})
    servo = arm.source.bus.servos[0]
    servo.plant.block(servo.plant.position_ticks + 50.0)
    arm.move(0, 0.6, 60)
    measured = arm.tick(60)
    assert measured.position_rad[0] == pytest.approx(0.077, abs=0.01)
    assert abs(measured.load[0]) == pytest.approx(0.8, abs=0.01)
    assert abs(measured.current_a[0]) > 1.5
    arm.tick(250)
    assert arm.tick().status[0] & StatusFlag.OVERLOAD


def test_a_relaxed_arm_sinks_slowly_and_a_push_moves_it() -> None:
    arms = [driven(physics=physics) for physics in (True, False)]
    sunk = []
    for arm in arms:
        run_to_end(arm.hardware.switch_off(), arm.clock.advance)
        before = arm.tick().position_rad
        sunk.append(arm.tick(300).position_rad - before)
    assert sunk[0] == pytest.approx(sunk[1], abs=0.004)
    for arm in arms:
        arm.source.bus.servos[0].plant.push_permille = 300.0
    turned = [arm.tick(50).position_rad[0] for arm in arms]
    assert turned[0] == pytest.approx(turned[1], abs=0.02)
    assert turned[0] > 0.3


def test_a_hand_moves_a_joint_a_jump_places_it_and_a_mirrored_horn_leaves_it_where_it_is() -> None:
    arm = driven(physics=True, start_rad={})
    servo, world = arm.source.bus.servos[4], world_of(arm)
    start_ticks = servo.plant.position_ticks
    servo.plant.hand_ticks = start_ticks + 400.0
    arm.tick(60)
    assert servo.plant.position_ticks == pytest.approx(start_ticks + 400.0, abs=5.0)
    servo.plant.hand_ticks = None
    servo.plant.position_ticks = start_ticks
    arm.tick()
    assert servo.plant.position_ticks == pytest.approx(start_ticks, abs=20.0)
    run_to_end(arm.hardware.switch_off(), arm.clock.advance)
    before = world.position_rad.copy()
    servo.mirror()
    arm.tick()
    assert world.position_rad == pytest.approx(before, abs=0.002)


def world_of(arm: Driven) -> World:
    return arm.source.world


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_unstable_world_is_a_lost_arm_and_starts_again_from_its_last_positions(value: float) -> None:
    arm = driven(physics=True)
    world = world_of(arm)
    sphere = BodyShape("sphere", (0.05,), (0.0, 0.0, 0.0), LEVEL)
    world.set_bodies(SetBodies(1, (Body("fixed", (sphere,), (0.0, 0.5, 0.05), LEVEL),)))
    before = arm.tick().position_rad
    world.data.xfrc_applied[:] = value
    with pytest.raises(PortLost, match="the physics had no finite positions, and was reset"):
        arm.tick()
    assert arm.tick().position_rad == pytest.approx(before, abs=0.02)
    assert world.pose("object/fixed")[0] == (0.0, 0.5, 0.05)


def test_a_starved_loop_makes_the_world_slow_and_never_faulty() -> None:
    arm = driven(physics=True)
    before = arm.tick(50)
    arm.clock.advance(30.0)
    after = arm.hardware.read()
    assert after.position_rad == pytest.approx(before.position_rad, abs=0.01)
    assert not after.status.any()
