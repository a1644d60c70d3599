"""Features of each arm by its names: orders, state and control, commissioning, teaching and teleoperation."""

import asyncio
import functools
import os
from collections.abc import Callable, Mapping
from dataclasses import replace

from protocol.messages import Stamp
from robot.arm import config_of_next
from robot.arm_group import ArmGroup
from robot.errors import OrderRefused
from robot.messages import ArmHealth, ArmState
from robot.stop_epochs import STOP_EPOCHS
from server.access.control_lease import ControlServices
from server.arm.arms import ArmFiles, read_now
from server.arm.calibrating import CalibrationProcedure, Recalibrated, calibration_file
from server.arm.commissioning import BEGIN, Commissioning, Ended, Procedure
from server.arm.interface import TOPIC as JOINT_STATES
from server.arm.interface import ArmStateTopics, offer_arm_services, offer_pace
from server.arm.verifying import FirstMotions, VerificationProcedure
from server.chunks.action_chunks import ActionChunks
from server.config import Settings
from server.features.context import ArmContext, ServerContext
from server.lifecycle import Feature
from server.moveit.named_states import data_directory, default_path
from server.moveit.servo.servo_node import servo_setup
from server.teaching.replay import offer_replay
from server.teaching.services import Teaching
from server.teaching.taught_motion import MotionFiles
from server.teleop.session import Follower
from server.teleop.teleoperation import Teleoperation


class ArmControl(Feature):
    """Services that switch, stop and pace an arm, topics of its state, and the lease of its control."""

    name = "control"

    def __init__(self, context: ServerContext) -> None:
        self._arms = {each.name: each for each in context.arms}
        self._states = {
            each.name: ArmStateTopics(each.graph, each.robot, each.arm.state, each.served.description.calibration)
            for each in context.arms
        }
        self._control = []
        for each in context.arms:
            offer_arm_services(each)
            offer_pace(each.graph, each.arm)
            self._control.append(ControlServices(each.graph, context.access.lease_of(each.name)))

    async def start(self) -> None:
        STOP_EPOCHS.listeners.add(self._show_stops_soon)

    async def stop(self) -> None:
        STOP_EPOCHS.listeners.discard(self._show_stops_soon)
        for each in self._control:
            each.close()

    def _show_stops_soon(self) -> None:
        # The stop itself goes first. A client that has its answer finds its number.
        asyncio.get_running_loop().call_soon(self._show_stops)

    def _show_stops(self) -> None:
        for name, each in self._arms.items():
            self._states[name].take_state(each.arm.state, each.arm.last_stop)

    def on_state(self, arm: str, state: ArmState) -> None:
        each = self._arms[arm]
        # The joints of all arms are published without subscribers too, for a recording. To publish one arm's joints as
        # well would cost as much again.
        if not arm or each.node.subscribers(JOINT_STATES):
            self._states[arm].publish_joints(read_now(each.arm, state))
        self._states[arm].take_state(state, each.arm.last_stop)

    def on_health(self, arm: str, health: ArmHealth) -> None:
        self._states[arm].take_health(health)


class CommissioningOfArms(Feature):
    """Commissioning of each arm, which publishes a calibration with which this server has started again."""

    name = "commissioning"

    def __init__(
        self,
        context: ServerContext,
        start_again: Callable[[Recalibrated], None],
        recalibrated: Recalibrated | None,
        *,
        shared_calibration: bool,
    ) -> None:
        self._start_again = start_again
        self._shared_calibration = shared_calibration
        self._of_arms: dict[str, Commissioning] = {}
        folder = data_directory(os.environ) / "verified_calibrations"
        self._first_motions = {each.name: FirstMotions(each.served, folder) for each in context.arms}
        for each in context.arms:
            ended = Ended(self._first_motions[each.name].advice)
            if recalibrated is not None and recalibrated.arm == each.name:
                ended = recalibrated.ended
            self._of_arms[each.name] = Commissioning(each.graph, functools.partial(self._begin, each), ended)

    async def start(self) -> None:
        """Limit the speed of arms that are not verified."""
        for each in self._first_motions.values():
            each.begin()

    async def stop(self) -> None:
        await asyncio.gather(*(each.close() for each in self._of_arms.values()))

    def on_state(self, arm: str, state: ArmState) -> None:
        self._of_arms[arm].take_state(state)

    def on_health(self, arm: str, health: ArmHealth) -> None:
        self._of_arms[arm].take_health(health)

    def _begin(self, context: ArmContext, procedure: str, name: str) -> Procedure:
        served, queue, arm = context.served, context.queue, context.arm
        if isinstance(arm, ArmGroup):
            services = ", ".join(f"/{name}{BEGIN}" for name in arm.states)
            sentence = "one arm is calibrated or verified at a time, by armbridge verify --arm NAME or by its service"
            raise OrderRefused(f"{sentence}: {services}")
        if busy := queue.busy(context.joints):
            raise OrderRefused(f"the arm is in use: {busy}")
        if procedure == "calibrate":
            if self._shared_calibration:
                raise OrderRefused("the arms of a classroom have one calibration together, which is not changed here")
            file = calibration_file(name, served.description)
            return CalibrationProcedure(arm, served, file, context.stop, self._start_again)
        if procedure == "verify":
            calibration = served.description.calibration
            joints = () if calibration is None else calibration.joints
            ends = frozenset(joint.joint for joint in joints if joint.servo.zero == "ends")
            return VerificationProcedure(
                arm, context.robot, ends, context.go_to, queue.cancel, self._first_motions[context.name]
            )
        raise OrderRefused(f"there is no procedure {procedure[:80]!r}, but calibrate and verify")


def with_calibration(settings: Settings, recalibrated: Recalibrated) -> Settings:
    """Return the settings with an arm's new calibration; the arm starts relaxed, since nobody has it switched on."""
    update = {"calibration": recalibrated.file, "start_enabled": False}
    if not recalibrated.arm:
        return settings.model_copy(update={"arm": settings.arm.model_copy(update=update)})
    arm = settings.arms[recalibrated.arm].model_copy(update=update)
    return settings.model_copy(update={"arms": {**settings.arms, recalibrated.arm: arm}})


def resumed(arms: Mapping[str, ArmFiles], recalibrated: Recalibrated) -> dict[str, ArmFiles]:
    """Return the arms as the server has left them, one of them relaxed with a new calibration."""
    after = {}
    for name, state in recalibrated.left.items():
        config = config_of_next(arms[name].config, state)
        if name == recalibrated.arm:
            hardware = config.hardware.resumed(recalibrated.position_rad, driven=False)
            config = replace(config, hardware=hardware, fault=None)
        after[name] = replace(arms[name], config=config)
    return after


def teaching_of(context: ServerContext) -> Teaching:
    """Return the recording of motions, beside the action that replays them."""
    robot = context.planning.robot
    # In a folder beside the named states.
    motions = MotionFiles(default_path("motions", robot, os.environ).with_suffix(""), robot)
    offer_replay(context.graph, context.planning, motions, context.goals.queue)
    return Teaching(context.graph, context.planning, motions)


class PolicyChunks(Feature):
    """Chunks of joint targets, which learned policies send to each arm."""

    name = "chunks"
    deadline_s = 0.5

    def __init__(self, context: ServerContext) -> None:
        self._of_arms = [ActionChunks(each, each.gripper, context.access.lease_of(each.name)) for each in context.arms]

    async def stop(self) -> None:
        await asyncio.gather(*(each.close() for each in self._of_arms))


# Name, for clients, of a follower that is the only arm.
ONLY_ARM = "arm"


def teleoperation_of(context: ServerContext) -> Teleoperation:
    """Return teleoperation, in which each arm that does not lead can follow."""
    robot, go_to = context.planning.robot, context.whole.go_to
    followers = [
        Follower(
            each.name or ONLY_ARM, each.served.prefix, each, servo_setup(robot, each.parameters), each.gripper, go_to
        )
        for each, _ in context.single_arms
        if not each.served.leads
    ]
    leaders = [each.name for each, _ in context.single_arms if each.served.leads]
    return Teleoperation(context.graph, followers, leaders)


TOPIC = "/clock"


class SimulatedTime(Feature):
    """Publishes the stamp of each state of the arm."""

    name = "the simulated time"

    def __init__(self, context: ServerContext) -> None:
        self._node = context.graph.node("clock")
        self._node.advertise(TOPIC, "rosgraph_msgs/Clock")

    @property
    def observes_states(self) -> bool:
        return bool(self._node.subscribers(TOPIC))

    def on_state(self, _arm: str, state: ArmState) -> None:
        self._node.publish(TOPIC, {"clock": Stamp.from_seconds(state.stamp_s).as_message()})
