"""What the page offers can be done, and what it says is so: its plans, refusals, panels, cameras and its connection."""

import base64
import io
import json
import signal
import time
from typing import Any

import pytest
from PIL import Image
from playwright.sync_api import Browser
from websockets.sync import client as blocking

from harness.clients import call, goal
from harness.page import DESKTOP, SHARED, SIZES, OpenPage, opened
from harness.server import RunningServer
from harness.waiting import TIMEOUT_S
from tests.helpers.arm_record import MOVED_RAD, ArmRecord

TOPIC = "/camera/image/compressed"
TYPE = "sensor_msgs/CompressedImage"

CONFIRM_MODE = "/moveit_goal_confirm_mode"
PREEMPTED, SUCCESS = -7, 1

SETTINGS = SHARED

# The server refuses a plan that starts 0.05 rad from the arm.
AWAY_RAD = 0.1

NO_STORAGE = "Storage.prototype.setItem = () => { throw new DOMException('full', 'QuotaExceededError'); };"


@pytest.fixture(scope="module")
def page(kept_page: OpenPage) -> OpenPage:
    return kept_page


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


def test_a_refusal_in_world_has_its_own_reason(page: OpenPage, server: RunningServer) -> None:
    assert not call(server.url, "/apply_planning_scene", {"scene": changed(-11.0)})["success"]
    page.open_panel("world", "saved-scenes")
    content = json.dumps(changed(-2.0)).encode()
    page.part("scene-file").set_input_files({"name": "scene.json", "mimeType": "application/json", "buffer": content})
    page.until_text("scene-result", "-2")
    assert "-11" not in page.part("scene-result").inner_text()


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


def picture(width: int, kind: str) -> dict[str, Any]:
    """Return a CompressedImage of a width."""
    file = io.BytesIO()
    Image.new("RGB", (width, 40), (20, 120, 200)).save(file, kind)
    return {"format": kind, "data": base64.b64encode(file.getvalue()).decode()}


def subscribers(server: RunningServer) -> list[str]:
    return list(call(server.url, "/rosapi/subscribers", {"topic": TOPIC})["subscribers"])


def test_a_camera_is_a_tile_while_it_is_seen(page: OpenPage, server: RunningServer) -> None:
    page.open_panel("cameras")
    page.part("cameras-empty").wait_for()
    with blocking.connect(server.url) as camera:
        camera.send(json.dumps({"op": "advertise", "topic": TOPIC, "type": TYPE}))
        page.wait(lambda: TOPIC in call(server.url, "/rosapi/topics_for_type", {"type": TYPE})["topics"])
        page.part("cameras-look").click()
        tile = page.part(f"camera-{TOPIC}")
        tile.wait_for()

        def shows(width: int, kind: str) -> bool:
            camera.send(json.dumps({"op": "publish", "topic": TOPIC, "type": TYPE, "msg": picture(width, kind)}))
            return bool(tile.evaluate("img => img.naturalWidth") == width)

        page.wait(lambda: shows(60, "jpeg"))
        page.wait(lambda: shows(80, "png"))
        page.open_panel("log")
        # The next picture finds the tile out of sight.
        page.wait(lambda: [shows(20, "png")] and subscribers(server) == [])


def test_a_goal_is_discarded_or_confirmed_by_a_person(page: OpenPage, record: ArmRecord, server: RunningServer) -> None:
    assert page.part("confirm").is_hidden()
    page.open_panel("move")
    named(server, "home")
    assert call(server.url, CONFIRM_MODE, {"data": True})["success"]
    with blocking.connect(server.url) as client:
        subscription = {"topic": "/moveit_goal_result", "type": "moveit_msgs/MoveItErrorCodes"}
        client.send(json.dumps({"op": "subscribe", **subscription}))
        for control, code in (("discard", PREEMPTED), ("confirm", SUCCESS)):
            began_s = time.time()
            message = {"topic": "/moveit_goal_named", "type": "std_msgs/String", "msg": {"data": "ready"}}
            client.send(json.dumps({"op": "publish", **message}))
            page.until_text("state-pill", "CONFIRM?")
            page.until_state("s.plan.trajectory !== null")
            page.until_text("next-step", "Confirm or Discard")
            assert not page.offers("go")
            assert cut_sizes(page) == []
            page.part(control).click()
            assert json.loads(client.recv(timeout=TIMEOUT_S))["msg"]["val"] == code
            assert (record.way_rad(began_s) > MOVED_RAD) is (control == "confirm")
            page.until("document.querySelector('[data-testid=confirm]').hidden")
    assert call(server.url, CONFIRM_MODE, {"data": False})["success"]


def cut_sizes(page: OpenPage) -> list[tuple[int, int]]:
    """Sizes of the window at which the sentence beside the buttons is not shown whole."""
    found = []
    for width, height in SIZES:
        page.page.set_viewport_size({"width": width, "height": height})
        if page.part("message").evaluate("message => message.scrollHeight > message.clientHeight + 1"):
            found.append((width, height))
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    return found


def test_the_page_comes_back_by_itself(tab: OpenPage, settings: dict[str, str]) -> None:
    page = tab
    with RunningServer(settings=settings) as server:
        page.open(server.port)
        named(server, "ready")
        plan_to(page, "home")
        server.end(signal.SIGKILL)
    page.until_state("!s.link.connected")
    assert page.part("primary").is_disabled()
    assert "grayscale" in page.part("view").evaluate("view => getComputedStyle(view).filter")
    page.part("stop").click()
    page.until_text("stop", "not acknowledged")
    stamp = page.state("joints.stamp")
    with RunningServer(f"--port {server.port}", settings):
        page.until_state(f"s.link.connected && s.joints.stamp > {stamp}")
        # Of the server before.
        assert not page.offers("go")
        page.part("named-ready").click()
        page.part("plan-and-move").click()
        page.until_state("s.goal.code === 1")
