"""Arms of one server: their files and their processes. One arm is the case of n = 1, whose name is empty."""

import functools
import itertools
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from robot.arm import Arm
from robot.arm_group import AnyArm, ArmGroup, joined_health, joined_state
from robot.calibration import Calibration
from robot.description.joined import PlacedArm, joined, prefixed
from robot.description.model import RobotModel
from robot.description.servo_table import HardwareTable
from robot.errors import RobotError
from robot.messages import ArmConfig, ArmHealth, ArmState
from robot.processes import StartedChild
from server.arm.interface import states_are_observed
from server.arm.setup import Description, arm_config
from server.config import ArmRole, ArmSettings, NamedArmSettings, Settings
from server.errors import ConfigurationError
from server.graph.topics import Graph
from server.lifecycle import Feature

log = logging.getLogger("armbridge.arm")

# Name of the robot that several arms are together, which is in the names of the files that the server keeps of it.
SEVERAL = "arms"

# A reading with every tick of the arm process.
LEADER_RATE_HZ = 100.0


@dataclass(frozen=True)
class ArmFiles:
    """An arm by its files."""

    settings: ArmSettings
    description: Description
    config: ArmConfig

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.description.robot.movable_joints)

    @property
    def leads(self) -> bool:
        """True for an arm that is moved by hand, and that others follow."""
        return isinstance(self.settings, NamedArmSettings) and self.settings.role is ArmRole.LEADER


def read_arms(settings: Settings, alone: Description | None = None) -> dict[str, ArmFiles]:
    """Read the files of all arms, each by its name; raises ConfigurationError for a file that cannot be used."""
    if not settings.arms:
        description = alone or Description.read(settings.arm)
        return {"": ArmFiles(settings.arm, description, arm_config(settings, description))}
    arms = {}
    for name, own in settings.arms.items():
        if own.role is ArmRole.LEADER:
            # It is moved by hand, and gets torque on request alone.
            update: dict[str, object] = {"start_enabled": False}
            if "joint_state_rate_hz" not in own.model_fields_set:
                # Its followers need every reading.
                update["joint_state_rate_hz"] = LEADER_RATE_HZ
            own = own.model_copy(update=update)
        try:
            arms[name] = _read(name, own, settings)
        except (ConfigurationError, RobotError) as error:
            raise ConfigurationError(f"arms.{name}: {error}") from error
    for (first, arm), (second, other) in itertools.combinations(settings.arms.items(), 2):
        if arm.base_xyz_m == other.base_xyz_m:
            remedy = "set base_xyz_m, or their goals are refused"
            log.warning("arms.%s and arms.%s stand in each other: %s", first, second, remedy)
    return arms


def _read(name: str, own: NamedArmSettings, settings: Settings) -> ArmFiles:
    plain = Description.read(own)
    if own.role is ArmRole.LEADER and own.serial is not None and own.calibration is None:
        raise ConfigurationError("a leader needs a calibration: without one nobody knows where its joints are")
    description = with_prefix(plain, name)
    own_settings = settings.model_copy(update={"arm": own, "emulator": own.emulator})
    return ArmFiles(own, description, arm_config(own_settings, description))


def with_prefix(description: Description, name: str) -> Description:
    """Return an arm whose joints, links and groups begin with its name; raises DescriptionError without a mesh."""
    hardware = description.hardware
    servos = tuple(replace(servo, joint=f"{name}_{servo.joint}") for servo in hardware.servos)
    calibration = description.calibration
    return replace(
        description,
        robot=prefixed(description.robot, name),
        hardware=replace(hardware, servos=servos),
        calibration=None if calibration is None else _renamed(calibration, f"{name}_{{}}".format),
        cameras={
            camera: each.model_copy(update={"frame": f"{name}_{each.frame}"})
            for camera, each in description.cameras.items()
        },
    )


def without_prefix(calibration: Calibration, prefix: str) -> Calibration:
    """Return a calibration as its file has it: with the joints' names of an arm that is alone."""
    return _renamed(calibration, lambda joint: joint.removeprefix(prefix))


def _renamed(calibration: Calibration, rename: Callable[[str], str]) -> Calibration:
    joints = (replace(each, servo=replace(each.servo, joint=rename(each.joint))) for each in calibration.joints)
    return replace(calibration, joints=tuple(joints))


def joined_robot(arms: Mapping[str, ArmFiles]) -> RobotModel:
    """Return the description of all arms at their places; raises ConfigurationError where they do not go together."""
    placed = {
        name: PlacedArm(arm.description.robot, arm.settings.base_xyz_m, arm.settings.base_rpy_rad)
        for name, arm in arms.items()
        if isinstance(arm.settings, NamedArmSettings)
    }
    try:
        return joined(SEVERAL, placed)
    except RobotError as error:
        raise ConfigurationError(f"arms: {error}") from error


@dataclass(frozen=True)
class ServedArm:
    """An arm by its name among several, or all arms together; the name of an only arm is empty."""

    name: str
    settings: ArmSettings
    description: Description
    arm: Arm | ArmGroup
    leads: bool = False

    @property
    def robot(self) -> RobotModel:
        return self.description.robot

    @property
    def section(self) -> str:
        return f"arms.{self.name}" if self.name else "arm"

    @property
    def prefix(self) -> str:
        """Beginning of the names of its joints and groups."""
        return self.name and f"{self.name}_"


# Share of a period after which the next state is passed on: states of an arm come a little early, too.
EARLIEST = 0.8


class JoinedBeat:
    """Beat in which the states of several arms, each with a clock of its own, are passed on as one."""

    def __init__(self, period_s: float) -> None:
        self._least_s, self._passed_on_s = EARLIEST * period_s, -math.inf

    def takes(self, now_s: float) -> bool:
        """Return True if an arm's state is due to be passed on with the latest states of the others.

        A busy machine brings the states of one arm in bursts, which are passed on once.
        """
        if now_s - self._passed_on_s < self._least_s:
            return False
        self._passed_on_s = now_s
        return True


class Arms:
    """All arms of a server, whose states go to its features; several have one together at the rate of one arm."""

    def __init__(self, files: Mapping[str, ArmFiles], graph: Graph, arm_process: StartedChild | None) -> None:
        self._graph = graph
        self._features: tuple[Feature, ...] = ()
        arms = {name: self._made(name, each, arm_process) for name, each in files.items()}
        self.each = tuple(
            ServedArm(name, each.settings, each.description, arms[name], each.leads) for name, each in files.items()
        )
        if "" in files:
            self.whole = self.each[0]
        else:
            leaders = frozenset(name for name, each in files.items() if each.leads)
            group = ArmGroup({name: (arms[name], each.joint_names) for name, each in files.items()}, leaders)
            robot = joined_robot(files)
            self.whole = ServedArm("", ArmSettings(), Description(robot.name, robot, HardwareTable(), None), group)
        self._beat = JoinedBeat(1.0 / max(each.settings.joint_state_rate_hz for each in files.values()))
        self._health: dict[str, ArmHealth] = {}

    def _made(self, name: str, files: ArmFiles, arm_process: StartedChild | None) -> Arm:
        on_state, on_health = functools.partial(self._take_state, name), functools.partial(self._take_health, name)
        return Arm(files.config, on_state, on_health, arm_process, observed=self._observed, name=name)

    def connect(self, features: Sequence[Feature]) -> None:
        """Have the features, which are made after the arms, take the states from now on, in their order."""
        self._features = tuple(features)

    def _observed(self) -> bool:
        """Return False when nobody sees the states at the moment."""
        return states_are_observed(self._graph) or any(feature.observes_states for feature in self._features)

    def _take_state(self, name: str, state: ArmState) -> None:
        for feature in self._features:
            feature.on_state(name, state)
        if name and self._beat.takes(time.monotonic()):
            self._take_state("", self.whole.arm.state)

    def _take_health(self, name: str, health: ArmHealth) -> None:
        """Pass the report on, and the report of all arms with the first arm's, which comes once a second."""
        for feature in self._features:
            feature.on_health(name, health)
        if name:
            self._health[name] = health
            if len(self._health) == len(self.each) and name == self.each[0].name:
                self._take_health("", joined_health(self._health))


def read_now(arm: AnyArm, state: ArmState) -> ArmState:
    """Return a state with the joints alone that are read at present: some of several arms may not be."""
    if not isinstance(arm, ArmGroup):
        return state
    states = arm.states
    return state if all(each.position_rad is not None for each in states.values()) else joined_state(states)
