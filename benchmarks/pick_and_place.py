"""Pick-and-places of a simulated SO-101 with physics, without a server and faster than time; physics counts successes.

A block is drawn beside the place for which the arm's poses are made. The arm process's supervisor grips, lifts and
carries it by the motions that a server would send, in time that passes as fast as the machine computes.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping

import numpy as np

from robot.calibration import Calibration
from robot.control.loop import hardware_opener
from robot.control.pacing import Pacer, Scheduling, SimulationClock
from robot.control.supervisor import Supervisor
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.limits import JointBounds, within_calibration
from robot.description.robot_folder import built_in
from robot.hardware.config import EmulatedConfig
from robot.messages import ArmConfig, Execute, MotionEnded, Outcome
from robot.physics.bodies import Body, BodyShape, BodyState, SetBodies
from robot.trajectory import PERIOD_S, MotionLimits, bridge

# Poses above and around a block of 25 x 25 x 50 mm at BLOCK_M, with the fingers open and closed [rad]. There the block
# is 6.6 mm from the fixed finger. With 2.5 mm less this finger came down on blocks; with 5.5 mm more the
# other finger pushed blocks so far that they fell over.
ABOVE = {"shoulder_lift": -0.456, "elbow_flex": 0.246, "wrist_flex": 1.6, "wrist_roll": -1.52}
AROUND = {"shoulder_lift": -0.184, "elbow_flex": 0.628, "wrist_flex": 1.128, "wrist_roll": -1.52}
BLOCK_M, HALF_M = (0.2, -0.0115, 0.025), (0.0125, 0.0125, 0.025)
OPEN_RAD, CLOSED_RAD, GRIP_SHARE = 1.0, -0.1, 0.4

# Ranges of what is drawn: shoulder [rad], offsets of the block [m], its turn about z [rad], and its mass [kg].
PAN_RAD, OFFSET_M, YAW_RAD, MASS_KG = 1.0, 0.008, 0.3, (0.01, 0.06)
CARRIED_RAD = 0.7

PUSHED_M, LIFTED_M, NEAR_M, STANDS_M = 0.01, 0.05, 0.03, 0.005
SETTLED_TICKS, MOST_TICKS = 50, 1000

MAX_FRICTION = 10.0


class TrialError(Exception):
    """Trial that did not succeed; the text is its cause."""


class SteppedArm:
    """Supervisor of an arm with physics, whose ticks follow each other at once."""

    def __init__(self) -> None:
        folder = built_in("so101")
        calibration = Calibration.nominal(folder.hardware.servos)
        robot = within_calibration(folder.model, calibration)
        config = ArmConfig(robot, EmulatedConfig(calibration, driven=True, physics=True))
        self.ticks = self._motion = 0
        self._clock, self._sent = SimulationClock(0.0), list[object]()
        self._supervisor = Supervisor(
            config, lambda message, **_: self._sent.append(message), self._clock, Scheduling()
        )
        self._supervisor.connect(hardware_opener(config, self._clock)())
        self._names = config.hardware.joint_names(robot)
        self._bounds = JointBounds.of(robot, self._names)
        self.tick(SETTLED_TICKS)

    def tick(self, count: int = 1) -> None:
        """Let ticks pass."""
        pacer = Pacer(0.0)
        for _ in range(count):
            self._supervisor.work()
            self.ticks += 1
            self._clock.start_tick(self.ticks * PERIOD_S)
            self._supervisor.tick(pacer, server_gone=False)

    def move(self, target_rad: Mapping[str, float], *, grips: bool = False) -> None:
        """Move joints from rest to rest; raises TrialError unless they arrive or grip."""
        arm = self._supervisor.arm
        assert arm is not None
        assert arm.controller is not None
        columns = [self._names.index(name) for name in target_rad]
        still, start = np.zeros(len(columns)), arm.controller.goal_rad[columns]
        acceleration = self._bounds.max_acceleration[columns]
        limits = MotionLimits(self._bounds.max_velocity[columns], acceleration, 10.0 * acceleration)
        end = np.array([*target_rad.values()]), still
        trajectory = bridge(tuple(target_rad), (start, still, still), end, limits, 0.1)
        self._motion += 1
        self._sent.clear()
        share = GRIP_SHARE if grips else 1.0
        self._supervisor.handle(Execute(self._motion, trajectory, gripping=grips, torque_share=share))
        for _ in range(MOST_TICKS):
            self.tick()
            for each in self._sent:
                if isinstance(each, MotionEnded):
                    if each.outcome not in (Outcome.REACHED, Outcome.GRIPPED):
                        raise TrialError(f"a motion failed: {each.message}")
                    return
        raise TrialError("a motion did not end")

    def put(self, body: Body) -> None:
        """Have one body in the world."""
        self._supervisor.handle(SetBodies(self.ticks, (body,)))

    @property
    def body(self) -> BodyState:
        """The body, once it has come to rest."""
        self.tick(SETTLED_TICKS)
        assert self._supervisor.arm is not None
        assert self._supervisor.arm.hardware.world is not None
        states = self._supervisor.arm.hardware.world.moved_bodies(every=True)
        assert states is not None
        return states.bodies[0]


def trial(arm: SteppedArm, random: np.random.Generator, friction: float) -> None:
    """Pick a drawn block and place it elsewhere; raises TrialError with the cause."""
    pan = float(random.uniform(-PAN_RAD, PAN_RAD))
    aside = pan - math.copysign(CARRIED_RAD, pan)
    x, y = turned(pan) + random.uniform(-OFFSET_M, OFFSET_M, 2)
    yaw = 0.5 * (float(random.uniform(-YAW_RAD, YAW_RAD)) - pan)
    level = (0.0, 0.0, 0.0, 1.0)
    shape = BodyShape("box", HALF_M, (0.0, 0.0, 0.0), level)
    orientation = (0.0, 0.0, math.sin(yaw), math.cos(yaw))
    mass_kg = float(random.uniform(*MASS_KG))
    arm.move({"gripper": OPEN_RAD})
    arm.move({**ABOVE, "shoulder_pan": pan})
    arm.put(Body("block", (shape,), (x, y, BLOCK_M[2]), orientation, True, mass_kg, friction))
    arm.move(AROUND)
    if math.dist(arm.body.position_m[:2], (x, y)) > PUSHED_M:
        raise TrialError("the open fingers pushed it away")
    arm.move({"gripper": CLOSED_RAD}, grips=True)
    if not arm.body.held:
        raise TrialError("the fingers closed beside it")
    arm.move(ABOVE)
    if arm.body.position_m[2] - BLOCK_M[2] < LIFTED_M:
        raise TrialError("it slipped out while it was lifted")
    for target in ({"shoulder_pan": aside}, AROUND):
        arm.move(target)
    if not arm.body.held:
        raise TrialError("it was lost on the way")
    for target in ({"gripper": OPEN_RAD}, ABOVE):
        arm.move(target)
    *placed, z = arm.body.position_m
    if abs(z - BLOCK_M[2]) > STANDS_M:
        raise TrialError("it fell over as it was let go")
    if (off_m := math.dist(placed, turned(aside))) > NEAR_M:
        raise TrialError(f"it stands {1e3 * off_m:.0f} mm from its place")


def turned(pan_rad: float) -> np.ndarray:
    """Return x and y of the gripped block with the shoulder turned [m]."""
    robot = built_in("so101").model
    still, placements = dict.fromkeys((each.name for each in robot.movable_joints), 0.0), ForwardPlacements(robot)
    here, there = (placements.transforms({**still, "shoulder_pan": pan})["gripper_link"] for pan in (0.0, pan_rad))
    at: np.ndarray = there @ np.linalg.inv(here) @ np.array([*BLOCK_M, 1.0])
    return at[:2]


def run(count: int = 20, seed: int = 1, friction: float = 1.0) -> None:
    """Run trials by seed; print the cause of each failure, and the share of successes."""
    failures, ticks, began_s = 0, 0, time.perf_counter()
    arm = SteppedArm()
    for number in range(count):
        try:
            trial(arm, np.random.default_rng((seed, number)), friction)
        except TrialError as cause:
            failures += 1
            print(f"block {number}: {cause}")
            ticks, arm = ticks + arm.ticks, SteppedArm()
    simulated_s, took_s = (ticks + arm.ticks) * PERIOD_S, time.perf_counter() - began_s
    print(f"friction {friction:g}, seed {seed}: {count - failures} of {count} blocks picked and placed")
    print(f"{simulated_s:.0f} s of the arm's time in {took_s:.0f} s: {simulated_s / took_s:.1f} times real time")


def main() -> None:
    """Run trials with options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.pick_and_place", description=__doc__)
    for name, default in (("count", 20), ("seed", 1), ("friction", 1.0)):
        parser.add_argument(f"--{name}", type=type(default), default=default, help="%(default)s unless given")
    options = parser.parse_args()
    if min(options.count - 1, options.seed) < 0 or not 0.0 <= options.friction <= MAX_FRICTION:
        parser.error(f"--count must be at least 1, --seed at least 0, and --friction 0 to {MAX_FRICTION:g}")
    run(**vars(options))


if __name__ == "__main__":
    main()
