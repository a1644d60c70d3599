"""Features of a server: arms, interfaces and MoveIt."""

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from harness.clients import ArmClient, values_of
from harness.waiting import until
from planners.pool import PlannerPool
from protocol.registry import Registry
from protocol.type_descriptions import message_hash
from robot.arm import Arm
from robot.description.model import RobotModel, parse
from robot.description.servo_table import HardwareTable
from robot.faults import Fault, FaultCode
from robot.messages import ArmState, Mode
from robot.stop_epochs import STOP_EPOCHS
from server.app import App
from server.arm.arms import ServedArm, read_arms
from server.arm.calibrating import Recalibrated
from server.arm.commissioning import Ended
from server.arm.interface import STATE_TOPIC
from server.arm.setup import Description
from server.config import ArmSettings, GoalSettings, GuardSettings, Settings
from server.execution.goal import TimeLimits
from server.features.arms import ArmControl, resumed, with_calibration
from server.features.clients import PATH
from server.features.context import ServerContext, context_of
from server.features.moveit import PlanningScene, slow_to_brake
from server.graph.permissions import Role
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from tests.helpers import robots
from tests.helpers.fake_arm import FakeArm
from tests.helpers.graph import answered, listen
from tests.helpers.messages import REGISTRY
from tests.helpers.robots import so101
from tests.helpers.rules import server_rules, started


def test_what_one_arm_can_do_each_of_several_can() -> None:
    one = {name: rule for rules in server_rules() for name, rule in rules.items()}
    several = {name: rule for rules in server_rules("left", "right") for name, rule in rules.items()}
    of_arms = {arm: {name for name, rule in several.items() if rule.arm == arm} for arm in ("left", "right")}
    for arm, names in of_arms.items():
        assert {name: replace(several[name], arm="") for name in names} == {
            name: one[name.removeprefix(f"/{arm}")] for name in names
        }
    left, right = ({name.removeprefix(f"/{arm}") for name in names} for arm, names in of_arms.items())
    assert left == right
    # All that has a rule here and is no matter of the scene, of planning or of files.
    shared = ("/arm/scenes/", "/moveit_goal_confirm_mode", "/moveit_goal_approv", "/arm/servo_history")
    arms_own = ("/arm/", "/servo_node/", "/moveit_goal", "/stop", "/emergency_stop", "/teleop/", "/trajectory_exec")
    assert {name for name in one if name.startswith(arms_own) and not name.startswith(shared)} <= left
    # A way to the rest pose is of one arm.
    controller = ("_controller/joint_trajectory", "_controller/follow_joint_trajectory")
    assert not {name for name in left if name not in several and not name.endswith(controller)}


async def test_each_of_several_arms_is_commissioned_by_its_name() -> None:
    app = await started(Settings.model_validate({"arms": {"left": {}, "right": {}}}))

    def begin(arm: str) -> Any:
        return answered(app.graph, f"{arm}/arm/commissioning/begin", procedure="verify", name="").values

    assert "or by its service: /left/arm/commissioning/begin, /right/" in begin("")["message"]
    assert begin("/left") == {"success": True, "message": "verify begins: see /left/arm/commissioning/state"}
    busy = "verify is in progress: answer it on the page, or call /left/arm/commissioning/cancel"
    assert begin("/left")["message"] == busy
    assert begin("/right")["success"]
    for arm in ("left", "right"):
        assert answered(app.graph, f"/{arm}/arm/commissioning/cancel").values["success"]


async def test_a_procedure_that_begins_is_shown_at_once_in_place_of_the_end_of_the_last_one() -> None:
    app = await started(Settings())
    states = listen(app.graph, "/arm/commissioning/state")
    for _ in range(2):
        answered(app.graph, "/arm/commissioning/begin", procedure="verify", name="")
        assert (states[-1]["procedure"], states[-1]["result"]) == ("verify", "")
        answered(app.graph, "/arm/commissioning/cancel")
        await until(lambda: states[-1]["result"] == "verify ended early: cancelled")


def test_a_new_calibration_is_that_of_its_arm_alone(tmp_path: Path) -> None:
    settings = Settings.model_validate({"arms": {"left": {}, "right": {}}})
    arms = read_arms(settings)
    position_rad = dict.fromkeys(arms["left"].joint_names, 0.1)
    holding = {name: ArmState(0.0, Mode.HOLDING, (), torque_enabled=True) for name in arms}
    recalibrated = Recalibrated("left", tmp_path / "new.json", position_rad, Ended(), holding)
    changed = with_calibration(settings, recalibrated)
    assert (changed.arms["left"].calibration, changed.arms["left"].start_enabled) == (tmp_path / "new.json", False)
    assert changed.arms["right"] == settings.arms["right"]
    after = resumed(arms, recalibrated)
    assert after["left"].config.hardware == arms["left"].config.hardware.resumed(position_rad, driven=False)
    # It is taken over as it holds.
    assert after["right"].config.hardware == arms["right"].config.hardware.resumed({}, driven=True)


LEFT_RELAXED = ArmState(0.0, Mode.RELAXED, ())
LEFT_CUT = ArmState(0.0, Mode.FAULT, (), fault=Fault(FaultCode.EMERGENCY_STOP, "torque is off"))
LEFT_STOPPED = ArmState(0.0, Mode.HOLDING, (), torque_enabled=True, stopped=True)


@pytest.mark.parametrize("left", [LEFT_RELAXED, LEFT_CUT, LEFT_STOPPED])
async def test_a_start_after_a_calibration_enables_no_other_arm_and_keeps_its_fault_and_stop(
    tmp_path: Path, left: ArmState
) -> None:
    arms = read_arms(Settings.model_validate({"arms": {"left": {}, "right": {}}}))
    recalibrated = Recalibrated("left", tmp_path / "new.json", {}, Ended(), {"left": left, "right": left})
    configs = {name: each.config for name, each in resumed(arms, recalibrated).items()}
    right = configs["right"]
    assert (right.start_enabled, right.fault, right.stopped) == (False, left.fault, left.stopped)
    assert right.hardware == arms["right"].config.hardware.resumed({}, driven=left.torque_enabled)
    assert (configs["left"].start_enabled, configs["left"].stopped) == (False, left.stopped)
    # The handle passes both on to the arm process, and shows them before it has answered.
    state = Arm(right, lambda _state: None).state
    assert (state.fault, state.stopped) == (left.fault, left.stopped)


async def document(**settings: Any) -> Any:
    app = App(Settings.model_validate(settings))
    response = await app._clients.routes[PATH](Request(f"/{PATH}", Headers()))
    assert (response.status, response.headers["Content-Type"]) == (200, "application/json")
    for feature in app.features:
        if feature.name == "the logs":
            await feature.stop()
    return json.loads(response.body)


async def test_the_interface_has_the_rules_by_which_the_server_decides() -> None:
    got = await document()
    for kind, rules in zip(("services", "topics", "actions"), server_rules(), strict=True):
        assert rules
        for name, rule in rules.items():
            shown = got[kind][name]
            assert (shown["role"], shown["drives"], shown["stops"]) == (rule.role.name.lower(), rule.drives, rule.stops)
    assert got["topics"]["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    assert got["services"]["/moveit_goal"]["type"] == "armbridge_msgs/srv/MoveitGoal"
    assert got["roles"] == [role.name.lower() for role in Role]
    assert [arm["name"] for arm in got["arms"]] == [""]
    assert (got["arms"][0]["frame"], got["arms"][0]["tip"]) == ("base_link", "gripper_frame_link")
    assert len(got["arms"][0]["groups"][got["arms"][0]["group"]]) == 5


async def test_names_that_a_setting_hides_are_left_out_and_stops_are_not() -> None:
    got = await document(access={"services_glob": ["/moveit_goal"], "topics_glob": ["/joint_states"]})
    assert {name for name in got["services"] if not name.startswith("/rosapi/")} >= {"/moveit_goal", "/arm/stop"}
    assert "/arm/enable" not in got["services"]
    assert "/stop" in got["topics"]
    assert "/arm/state" not in got["topics"]


async def test_each_type_has_its_hash_and_each_of_several_arms_its_description() -> None:
    registry, got = Registry.load(), await document(arms={"left": {}, "right": {}})
    assert got["types"].keys() == set(registry.type_names())
    assert got["types"]["std_msgs/msg/String"] == message_hash(registry, "std_msgs/msg/String")
    assert got["types"]["armbridge_msgs/action/MoveitGoal"].startswith("sha256_")
    assert [arm["name"] for arm in got["arms"]] == ["", "left", "right"]
    assert got["arms"][1]["tip"].startswith("left")


CANCELED, SUCCEEDED = 5, 4
MOVE, MOVE_TYPE = "/move_action", "moveit_msgs/action/MoveGroup"
JOINT_GOAL = ("/moveit_goal_joints", "sensor_msgs/JointState")
RESULT, STATUS = "/moveit_goal_result", "/moveit_goal_status"

# Backlash, droop and one tick of rounding.
ARRIVED_RAD = 0.06


def to(position_rad: float, scaling: float = 0.3, **options: Any) -> dict[str, Any]:
    """A goal as sparse as clients write it."""
    constraint = {"joint_constraints": [{"joint_name": "shoulder_pan", "position": position_rad}]}
    request = {"group_name": "arm", "max_velocity_scaling_factor": scaling, "goal_constraints": [constraint]}
    return {"request": request, "planning_options": options}


async def test_goals_follow_one_another_and_a_planned_trajectory_is_executed_and_cancelled(client: ArmClient) -> None:
    async def result(goal_id: str) -> tuple[int, int]:
        ended = await client.result(goal_id)
        return ended["status"], ended["values"]["error_code"]["val"]

    first = await client.send_goal(MOVE, MOVE_TYPE, to(0.8))
    await client.until_mode("moving")
    second = await client.send_goal("/move_group", MOVE_TYPE, to(-0.2, 1.0))
    assert (await result(first), await result(second)) == ((CANCELED, -7), (SUCCEEDED, 1))
    goal = await client.send_goal(MOVE, MOVE_TYPE, to(0.9, plan_only=True))
    planned = (await client.result(goal))["values"]["planned_trajectory"]
    name = "/execute_trajectory"
    goal = await client.send_goal(name, "moveit_msgs/action/ExecuteTrajectory", {"trajectory": planned})
    await client.until_mode("moving")
    await client.say("cancel_action_goal", action=name, id=goal)
    assert await result(goal) == (CANCELED, -7)
    assert await client.until_mode("holding")


async def test_settings_reach_their_parts() -> None:
    arm = ArmSettings(guards=GuardSettings(gripper_torque_limit=0.3))
    times = {"allowed_execution_duration_scaling": 3.0, "allowed_goal_duration_margin": 4.0}
    parameters = MoveItParameters(**times, publish_planning_scene_hz=2.0)
    context = context_for(so101(), Settings(arm=arm, moveit=parameters, goals=GoalSettings(max_paused_s=5.0)))
    limits, gripper = TimeLimits(3.0, 4.0, 5.0), context.whole.gripper
    assert gripper is not None
    assert context.goals.executors.time_limits == limits
    assert (gripper._velocity_scaling, gripper._torque_limit, gripper._time_limits) == (0.3, 0.3, limits)
    assert PlanningScene(context)._interface._publisher._period_s == 0.5


def context_for(robot: RobotModel, settings: Settings | None = None) -> ServerContext:
    settings = settings or Settings()
    served = ServedArm("", settings.arm, Description("", robot, HardwareTable(), None), FakeArm().as_arm)
    return context_of(settings, Graph(REGISTRY), (served, (served,)), PlannerPool(robot))


def test_joints_that_brake_slowly_are_named_for_steering() -> None:
    robot = so101()
    assert slow_to_brake(robot) == {}
    slow = replace(robot.joints["elbow_flex"], max_acceleration=robot.joints["elbow_flex"].max_velocity / 2.0)
    assert slow_to_brake(replace(robot, joints={**robot.joints, "elbow_flex": slow})) == {"elbow_flex": 2.0}


def test_an_arm_has_the_gripper_of_its_description() -> None:
    with_gripper, without = so101(), parse(robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)
    gripper = context_for(with_gripper).whole.gripper
    assert gripper is not None
    assert gripper.joints == (with_gripper.joints["gripper"],)
    assert context_for(without).whole.gripper is None


async def finished(client: ArmClient, count: int) -> dict[str, Any]:
    return (await client.until(RESULT, lambda all_: len(all_) >= count))[count - 1]


def last_pan_rad(shown: dict[str, Any]) -> float:
    """Return the end of a displayed path."""
    path = shown["trajectory"][0]["joint_trajectory"]
    return float(path["points"][-1]["positions"][path["joint_names"].index("shoulder_pan")])


async def test_a_saved_state_is_a_named_goal_and_moves_after_its_confirmation(client: ArmClient) -> None:
    await client.goal(*JOINT_GOAL, {"name": ["shoulder_pan"], "position": [0.3]})
    assert (await finished(client, 1))["val"] == 1
    assert (await client.call("/save_robot_state", name="Beside the mug"))["success"]
    await client.goal(*JOINT_GOAL, {"name": ["shoulder_pan"], "position": [0.0]})
    await finished(client, 2)
    assert (await client.call("/moveit_goal_confirm_mode", data=True))["success"]
    try:
        await client.say("subscribe", topic=STATUS, type="diagnostic_msgs/DiagnosticStatus")
        await client.say("subscribe", topic="/display_planned_path", type="moveit_msgs/DisplayTrajectory")
        await client.goal("/moveit_goal_named", "std_msgs/String", {"data": "beside the mug"})
        await client.until(STATUS, lambda all_: values_of(all_[-1])["state"] == "planned")
        await client.until("/display_planned_path", lambda shown: abs(last_pan_rad(shown[-1]) - 0.3) < ARRIVED_RAD)
        assert abs(client.topics["/joint_states"][-1]["position"][0]) < ARRIVED_RAD
        waiting = client.topics[STATUS][-1]["hardware_id"]
        await client.goal("/moveit_goal_approve", "std_msgs/String", {"data": waiting})
        assert (await finished(client, 3))["val"] == 1
        assert abs(client.topics["/joint_states"][-1]["position"][0] - 0.3) < ARRIVED_RAD
    finally:
        await client.call("/moveit_goal_confirm_mode", data=False)


async def test_the_number_of_a_stop_is_shown_at_once() -> None:
    app = await started(Settings())
    (control,) = (each for each in app.features if isinstance(each, ArmControl))
    states = listen(app.graph, STATE_TOPIC)
    await control.start()
    number = STOP_EPOCHS.begin()
    await asyncio.sleep(0)
    await control.stop()
    STOP_EPOCHS.begin()
    await asyncio.sleep(0)
    assert values_of(states[-1])["stops"] == str(number)
