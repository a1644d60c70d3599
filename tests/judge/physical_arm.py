"""The arm process in a physical world, in a time of its own: the controller's path from a trajectory to the links."""

import itertools
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

from planners.pipeline import Planner
from robot.control.loop import hardware_opener
from robot.hardware.config import EmulatedConfig
from robot.hardware.interface import HardwareInterface
from robot.messages import Execute, Mode, Outcome, Stop
from robot.physics.bodies import Body, SetBodies
from robot.physics.world import World
from robot.trajectory import PERIOD_S, Trajectory, Vector
from tests.helpers.arm_rig import CALIBRATION, NAMES, ROBOT, ArmRig

MAX_MOTION_S = 30.0
REST_S = 1.0

Pair = tuple[str, str]


@cache
def planner() -> Planner:
    """A planner whose searches get as far on every machine."""
    return Planner(ROBOT, partial(next, itertools.count(0.0, 0.002)))


@dataclass
class Played:
    """Motion as it was played, by ticks: measured positions and goals, shape (joints,) each [rad]."""

    position_rad: list[Vector] = field(default_factory=list)
    goal_rad: list[Vector] = field(default_factory=list)
    depth_m: dict[Pair, float] = field(default_factory=dict)  # deepest depth of each contact of a link
    outcome: Outcome | None = None
    message: str = ""


class ArmInWorld(ArmRig):
    """A supervisor whose emulated servos move a physical arm from zero, or, without physics, the light emulation's."""

    def __init__(self, *bodies: Body, physics: bool = True, **start_rad: float) -> None:
        super().__init__(hardware=EmulatedConfig(CALIBRATION, physics=physics, start_rad=start_rad, driven=True))
        if bodies:
            self.supervisor.handle(SetBodies(1, bodies))
        while self.mode is not Mode.HOLDING:
            assert self.mode is not Mode.FAULT, self.fault_code
            self.tick()

    def _hardware(self) -> HardwareInterface:
        self.hardware = hardware_opener(self.config, self.clock)()
        return self.hardware

    @property
    def world(self) -> World:
        return self.hardware.world

    @property
    def goals_rad(self) -> dict[str, float]:
        """Positions that the arm holds, by joint."""
        return dict(zip(NAMES, self.state.goal_rad.tolist(), strict=True))

    def play(self, trajectory: Trajectory, stop_after_s: float = MAX_MOTION_S, **options: Any) -> Played:
        """Play a trajectory to its end, or stop it after a time, and wait for rest."""
        self._numbers += 1
        self.supervisor.handle(Execute(self._numbers, trajectory, **options))
        played = Played()
        ends, ticks = len(self.ended), 0
        while len(self.ended) == ends:
            assert ticks < MAX_MOTION_S / PERIOD_S, "the motion did not end"
            if ticks == round(stop_after_s / PERIOD_S):
                self.supervisor.handle(Stop())
            self._record(played)
            ticks += 1
        for _ in range(round(REST_S / PERIOD_S)):
            self._record(played)
        played.outcome, played.message = self.ended[ends].outcome, self.ended[ends].message
        return played

    def _record(self, played: Played) -> None:
        self.tick()
        state = self.state
        played.position_rad.append(state.position_rad)
        played.goal_rad.append(state.position_rad if state.goal_rad is None else state.goal_rad)
        if self.hardware.world is not None:
            for pair, depth_m in touched_m(self.hardware.world).items():
                played.depth_m[pair] = max(depth_m, played.depth_m.get(pair, 0.0))


def touched_m(world: World) -> dict[Pair, float]:
    """Return the depth of each contact of a link with another link or an object [m]."""
    model, contact = world.model, world.data.contact
    found: dict[Pair, float] = {}
    for pair, distance_m in zip(contact.geom.tolist(), contact.dist.tolist(), strict=True):
        first, second = sorted(model.body(int(model.geom_bodyid[geom])).name for geom in pair)
        if not first.startswith("object/") or not second.startswith(("object/", "world")):
            found[first, second] = max(-distance_m, found.get((first, second), 0.0))
    return found
