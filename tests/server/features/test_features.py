"""Features of one arm and of several: the same names, each below the arm's own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from server.arm.arms import read_arms
from server.arm.calibrating import Recalibrated
from server.arm.commissioning import Ended
from server.config import Settings
from server.features.arms import resumed, with_calibration
from tests.helpers.graph import answered
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
    shared = ("/arm/scenes/", "/moveit_goal_confirm", "/moveit_goal_approv", "/arm/servo_history")
    arms_own = ("/arm/", "/servo_node/", "/moveit_goal", "/stop", "/emergency_stop", "/teleop/", "/trajectory_exec")
    assert {name for name in one if name.startswith(arms_own) and not name.startswith(shared)} <= left
    # A way to the rest pose is of one arm.
    controller = ("_controller/joint_trajectory", "_controller/follow_joint_trajectory")
    assert not {name for name in left if name not in several and not name.endswith(controller)}


async def test_each_of_several_arms_is_commissioned_by_its_name() -> None:
    app = await started(Settings.model_validate({"arms": {"left": {}, "right": {}}}))

    def begin(arm: str) -> Any:
        return answered(app.graph, f"{arm}/arm/commissioning/begin", procedure="verify", name="").values

    assert "by the service of its name: /left/arm/commissioning/begin, /right/" in begin("")["message"]
    assert begin("/left") == {"success": True, "message": "verify begins: see /left/arm/commissioning/state"}
    busy = "verify is in progress: answer it, or call /left/arm/commissioning/cancel"
    assert begin("/left")["message"] == busy
    assert begin("/right")["success"]
    for arm in ("left", "right"):
        assert answered(app.graph, f"/{arm}/arm/commissioning/cancel").values["success"]


def test_a_new_calibration_is_that_of_its_arm_alone(tmp_path: Path) -> None:
    settings = Settings.model_validate({"arms": {"left": {}, "right": {}}})
    arms = read_arms(settings)
    position_rad = dict.fromkeys(arms["left"].joint_names, 0.1)
    recalibrated = Recalibrated("left", tmp_path / "new.json", position_rad, Ended())
    changed = with_calibration(settings, recalibrated)
    assert (changed.arms["left"].calibration, changed.arms["left"].start_enabled) == (tmp_path / "new.json", False)
    assert changed.arms["right"] == settings.arms["right"]
    after = resumed(arms, recalibrated)
    assert after["left"].config.hardware == arms["left"].config.hardware.resumed(position_rad, driven=False)
    assert after["right"] is arms["right"]
