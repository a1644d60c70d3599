"""Several arms of one server: their files, their processes, and what each has below its name."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from robot.arm import Arm
from robot.arm_group import ArmGroup, joined_health, joined_state
from robot.description.joined import PlacedArm, joined, prefixed
from robot.description.model import RobotModel
from robot.errors import RobotError
from robot.messages import ArmConfig, ArmHealth, ArmState
from server.access.control_lease import ControlLease, ControlServices
from server.arm.services import ArmPace, ArmServices
from server.arm.setup import Description, arm_config
from server.arm.topics import TOPIC as JOINT_STATES
from server.arm.topics import ArmStateTopics, JointStates
from server.config import ArmRole, NamedArmSettings, Settings
from server.errors import ConfigurationError
from server.graph.namespace import Namespace
from server.graph.topics import Graph

# Name of the robot that several arms are together, which is in the names of the files that the server keeps of it.
SEVERAL = "arms"

# A reading with every tick of the arm process.
LEADER_RATE_HZ = 100.0


@dataclass(frozen=True)
class ArmFiles:
    """One of several arms by its files.

    Attributes:
        settings: its own.
        description: with prefixed names.
        config: of its process.
    """

    settings: NamedArmSettings
    description: Description
    config: ArmConfig

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Its joints."""
        return tuple(joint.name for joint in self.description.robot.movable_joints)


def read_arms(settings: Settings) -> dict[str, ArmFiles]:
    """Read the files of several arms.

    Raises:
        ConfigurationError: a file or a setting that cannot be used.
    """
    arms = {}
    for name, own in settings.arms.items():
        if own.role is ArmRole.LEADER:
            # It is moved by hand, and gets torque on request alone.
            update: dict[str, object] = {"start_enabled": False}
            if "joint_state_rate_hz" not in own.model_fields_set:
                # Those who follow it need every reading.
                update["joint_state_rate_hz"] = LEADER_RATE_HZ
            own = own.model_copy(update=update)
        try:
            arms[name] = _read(name, own, settings)
        except (ConfigurationError, RobotError) as error:
            raise ConfigurationError(f"arms.{name}: {error}") from error
    return arms


def _read(name: str, own: NamedArmSettings, settings: Settings) -> ArmFiles:
    plain = Description.read(own)
    if own.role is ArmRole.LEADER and own.serial is not None and own.calibration is None:
        raise ConfigurationError("a leader needs a calibration: without one nobody knows where its joints are")
    description = with_prefix(plain, name)
    own_settings = settings.model_copy(update={"arm": own, "emulator": own.emulator})
    return ArmFiles(own, description, arm_config(own_settings, description))


def with_prefix(description: Description, name: str) -> Description:
    """Return an arm by its files whose joints, links and groups begin with its name.

    Raises:
        DescriptionError: a mesh is not there.
    """
    prefix = f"{name}_"
    hardware = description.hardware
    servos = {servo.joint: replace(servo, joint=prefix + servo.joint) for servo in hardware.servos}
    calibration = description.calibration
    if calibration is not None:
        joints = tuple(
            replace(each, servo=replace(each.servo, joint=prefix + each.joint)) for each in calibration.joints
        )
        calibration = replace(calibration, joints=joints)
    return replace(
        description,
        robot=prefixed(description.robot, name),
        hardware=replace(hardware, servos=tuple(servos.values())),
        calibration=calibration,
    )


def joined_robot(arms: Mapping[str, ArmFiles]) -> RobotModel:
    """Return the description of all arms at their places.

    Raises:
        ConfigurationError: they do not go together.
    """
    placed = {
        name: PlacedArm(arm.description.robot, arm.settings.base_xyz_m, arm.settings.base_rpy_rad)
        for name, arm in arms.items()
    }
    try:
        return joined(SEVERAL, placed)
    except RobotError as error:
        raise ConfigurationError(f"arms: {error}") from error


class NamedArm:
    """One of several arms: its process, and its topics and services below its name.

    Args:
        graph: the graph of all arms.
        name: of the arm.
        files: by which it is known.
        on_state: called with every state of the arm.
        on_health: called with its condition.
        observed: returns False when nobody sees its states at the moment.

    Attributes:
        graph: the namespace of the arm.
        files: as given.
        arm: the arm.
    """

    def __init__(
        self,
        graph: Graph,
        name: str,
        files: ArmFiles,
        on_state: Callable[[ArmState], None],
        on_health: Callable[[ArmHealth], None],
        observed: Callable[[], bool],
    ) -> None:
        self.graph = Namespace(graph, name)
        self.files = files
        self._on_state = on_state
        self._on_health = on_health
        self.arm = Arm(files.config, self._take_state, self._take_health, observed=observed, name=name)
        self._joint_states = JointStates(self.graph)
        self._topics = ArmStateTopics(self.graph, files.description.robot, self.arm.state)
        self._control: ControlServices | None = None

    def open(self, end_goals: Callable[[str], None], lease: ControlLease) -> None:
        """Offer the services that switch and stop this arm alone.

        Args:
            end_goals: ends its goals and every motion of it, for a reason.
            lease: its control.
        """
        ArmServices(self.graph, self.arm, end_goals)
        ArmPace(self.graph, self.arm)
        self._control = ControlServices(self.graph, lease)

    def close(self) -> None:
        """Stop the timer of its control."""
        if self._control is not None:
            self._control.close()

    def _take_state(self, state: ArmState) -> None:
        # All joints are on the topic of all arms; this one costs as much again where several listen to that alone.
        if self.graph.subscribers(JOINT_STATES):
            self._joint_states.publish(state)
        self._topics.take_state(state, self.arm.last_stop)
        self._on_state(state)

    def _take_health(self, health: ArmHealth) -> None:
        self._topics.take_health(health)
        self._on_health(health)


# Shares of a period: arms whose states come later than that after the others are not waited for, and in a burst the
# next state is not told earlier.
LATE, EARLY = 1.5, 0.5


class JoinedBeat:
    """Beat in which the states of several arms, whose clocks are their own, are told as one.

    Args:
        names: of the arms.
        period_s: time between two states of an arm [s].
    """

    def __init__(self, names: frozenset[str], period_s: float) -> None:
        self._earliest_s, self._latest_s = EARLY * period_s, LATE * period_s
        # Those that have sent a state since the last time, and those that had before.
        self._fresh: set[str] = set()
        self._awaited: frozenset[str] = names
        self._told_s = -math.inf

    def takes(self, name: str, now_s: float) -> bool:
        """Return True if the state that an arm has sent is to be told with those of the others.

        It is when each arm has sent one that is not silent, or some are late. A busy machine brings the states of one
        arm in bursts, which are told once.

        Args:
            name: of the arm.
            now_s: monotonic time [s].
        """
        self._fresh.add(name)
        since_s = now_s - self._told_s
        if since_s < self._earliest_s or (since_s < self._latest_s and not self._fresh >= self._awaited):
            return False
        self._awaited = frozenset(self._fresh)
        self._fresh.clear()
        self._told_s = now_s
        return True


class NamedArms:
    """All arms of a server that has several.

    Args:
        graph: the graph.
        files: each arm by its name.
        on_arm_state: called with the name of an arm and its state, as soon as it comes.
        on_state: called with the state of all arms as one, as often as the arms send theirs, and with that of those
            alone that are read at present.
        on_health: called with the condition of all arms as one.
        observed: returns False when nobody sees the states at the moment.

    Attributes:
        arms: each by its name.
        group: all of them as one.
    """

    def __init__(
        self,
        graph: Graph,
        files: Mapping[str, ArmFiles],
        on_arm_state: Callable[[str, ArmState], None],
        on_state: Callable[[ArmState, ArmState], None],
        on_health: Callable[[ArmHealth], None],
        observed: Callable[[], bool],
    ) -> None:
        self._on_arm_state, self._on_state = on_arm_state, on_state
        self._on_health = on_health
        self._leaders = frozenset(name for name, each in files.items() if each.settings.role is ArmRole.LEADER)
        period_s = 1.0 / max(each.settings.joint_state_rate_hz for each in files.values())
        self._beat = JoinedBeat(frozenset(files), period_s)
        self._health: dict[str, ArmHealth] = {}
        self.arms = {name: self._made(graph, name, each, observed) for name, each in files.items()}
        self.group = ArmGroup(
            {name: (each.arm, each.files.joint_names) for name, each in self.arms.items()}, self._leaders
        )

    def _made(self, graph: Graph, name: str, files: ArmFiles, observed: Callable[[], bool]) -> NamedArm:
        def on_state(state: ArmState) -> None:
            self._on_arm_state(name, state)
            self._take_state(name)

        def on_health(health: ArmHealth) -> None:
            self._take_health(name, health)

        return NamedArm(graph, name, files, on_state, on_health, observed)

    def close(self) -> None:
        """Stop the timers."""
        for arm in self.arms.values():
            arm.close()

    def _take_state(self, name: str) -> None:
        if not self._beat.takes(name, time.monotonic()):
            return
        state, states = self.group.state, self.group.states
        all_read = all(each.position_rad is not None for each in states.values())
        self._on_state(state, state if all_read else joined_state(states, leaders=self._leaders))

    def _take_health(self, name: str, health: ArmHealth) -> None:
        """Tell the condition of all with that of the first, which comes once a second."""
        self._health[name] = health
        if len(self._health) == len(self.arms) and name == next(iter(self.arms)):
            self._on_health(joined_health(self._health))
