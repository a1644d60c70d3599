"""What the page offers can be done, and what it says is so: its plans, refusals, panels and what it has stored."""

import json
from typing import Any

import pytest
from playwright.sync_api import Browser
from websockets.sync import client as blocking

from harness.clients import call, goal
from harness.page import SHARED, OpenPage, opened
from harness.server import RunningServer

SETTINGS = SHARED

# The server refuses a plan that starts 0.05 rad from the arm.
AWAY_RAD = 0.1

NO_STORAGE = "Storage.prototype.setItem = () => { throw new DOMException('full', 'QuotaExceededError'); };"


def named(server: RunningServer, pose: str) -> str:
    """Move the arm to a named pose from elsewhere; returns the goal's id."""
    result = goal(server.url, "/moveit_goal_named", {"data": pose})
    assert result["val"] == 1, result
    return str(result["source"]).rsplit(" ", 1)[-1]


def plan_to(page: OpenPage, pose: str) -> None:
    page.open_panel("move")
    page.part(f"named-{pose}").click()
    page.press("plan")
    page.until_offered("go")


def test_a_plan_is_not_offered_once_the_arm_is_elsewhere(page: OpenPage, server: RunningServer) -> None:
    named(server, "ready")
    plan_to(page, "home")
    before = page.joints()["shoulder_pan"]
    command = {"joint_names": ["shoulder_pan"], "velocities": [1.0]}
    message = {
        "op": "publish",
        "topic": "/servo_node/delta_joint_cmds",
        "type": "control_msgs/JointJog",
        "msg": command,
    }
    with blocking.connect(server.url) as websocket:

        def has_gone() -> bool:
            websocket.send(json.dumps(message))
            return abs(page.joints()["shoulder_pan"] - before) > AWAY_RAD

        page.wait(has_gone)
    page.until_state("s.plan.trajectory === null")
    assert not page.offers("go")


def test_the_ghost_of_a_goal_offers_no_motion(page: OpenPage, server: RunningServer) -> None:
    named(server, "home")
    named(server, "ready")
    page.until_state("s.goal_history.some(({ goal }) => goal.state === 'done')")
    page.open_panel("goals")
    goal_id = page.state("goal_history.at(-1).goal.id")
    page.part(f"goal-open-{goal_id}").click()
    page.part(f"goal-ghost-{goal_id}").click()
    page.until_state("s.plan.trajectory !== null")
    page.open_panel("move")
    assert not page.offers("go")


@pytest.mark.parametrize("size_m", [-1.0, -2.0])
def test_a_refusal_in_world_has_its_own_reason(page: OpenPage, server: RunningServer, size_m: float) -> None:
    scene = changed(size_m - 10.0)
    assert not call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    page.open_panel("world", "saved-scenes")
    content = json.dumps(changed(size_m)).encode()
    page.part("scene-file").set_input_files({"name": "scene.json", "mimeType": "application/json", "buffer": content})
    page.until("document.querySelector('[data-testid=scene-result]').textContent !== ''")
    assert f"{size_m:g}" in page.part("scene-result").inner_text()
    assert f"{size_m - 10.0:g}" not in page.part("scene-result").inner_text()


def changed(size_m: float) -> dict[str, Any]:
    pose = {"position": {"x": 0.3, "y": 0.0, "z": 0.3}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    ball = {"id": "ball", "primitives": [{"type": 2, "dimensions": [size_m]}], "primitive_poses": [pose]}
    return {"is_diff": True, "world": {"collision_objects": [ball]}}


def test_a_panel_that_was_closed_works_after_a_reload(page: OpenPage, server: RunningServer) -> None:
    page.open_panel("drive")
    page.part("close-panel-drive").click()
    page.open(server.port)
    page.until_state("s.identity !== null")
    page.open_panel("drive")
    page.until("document.querySelectorAll('.jog-row').length > 5")
    assert page.part("jog-z-plus").is_enabled()


def test_an_episode_is_not_offered_where_nothing_is_recorded(page: OpenPage) -> None:
    page.open_panel("recording", "episodes")
    page.part("recording-off").wait_for()
    assert page.part("episode-start").is_disabled()


def test_a_sequence_that_the_browser_does_not_store_is_not_called_saved(
    browser: Browser, server: RunningServer
) -> None:
    with opened(browser, own=True) as page:
        page.page.add_init_script(NO_STORAGE)
        page.open(server.port)
        page.open_panel("sequence", "saved-sequences")
        page.until("!document.querySelector('[data-testid=add-here]').disabled")
        page.part("add-here").click()
        page.part("sequence-name").fill("mine")
        page.part("save-sequence").click()
        page.until_text("sequence-told", "stores nothing")
