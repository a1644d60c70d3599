"""What a person does with the page, on the emulated arm: look, plan, move, stop."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import call, goal, tip
from harness.page import SHARED, OpenPage, opened
from harness.server import RunningServer

# The server's own tolerance for a point (0.01 m), and the servos' droop.
ARRIVED_M = 0.02

# What an arm that was told to stand still may move between two looks.
STILL_RAD = 0.02

SETTINGS = SHARED


@pytest.fixture(scope="module")
def page(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, draws=True) as open_page:
        open_page.open(server.port)
        yield open_page


@pytest.fixture(autouse=True)
def _at_rest_and_fast(page: OpenPage, server: RunningServer) -> None:
    """Each test begins with an arm that takes goals, whatever became of the one before."""
    if page.state("arm.mode") == "fault":
        call(server.url, "/arm/reset_fault")
        page.until_state("s.arm.mode === 'holding'")
    set_speed(page, 100)


def set_speed(page: OpenPage, percent: float) -> None:
    slider = page.part("speed")
    high = float(slider.get_attribute("max") or 1)
    slider.fill(str(percent / 100 * high))
    slider.dispatch_event("change")


def type_target(page: OpenPage, position_m: tuple[float, float, float]) -> None:
    for axis, value_m in zip("xyz", position_m, strict=True):
        page.enter(f"target-{axis}", f"{1e3 * value_m:g}")


def move_to(server: RunningServer, name: str) -> None:
    assert goal(server.url, "/moveit_goal_named", {"data": name})["val"] == 1


def is_uncovered(page: OpenPage, test_id: str) -> bool:
    """Whether a click into the middle of an element meets it."""
    return bool(
        page.page.evaluate(
            """id => {
                const element = document.querySelector(`[data-testid='${id}']`);
                const box = element.getBoundingClientRect();
                const met = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
                return element === met || element.contains(met);
            }""",
            test_id,
        )
    )


def test_the_arm_is_drawn(page: OpenPage, server: RunningServer) -> None:
    page.until("window.armbridge.drawn.frames > 3")
    assert page.colours() > 50
    page.shot("ready")
    assert page.hosts == {f"127.0.0.1:{server.port}"}


def test_the_arm_moves_as_the_joint_states_do(page: OpenPage, server: RunningServer) -> None:
    for name, lift_rad in (("home", 0.0), ("ready", -0.5)):
        move_to(server, name)
        page.until_state(f"Math.abs(s.joints.position_rad[1] - {lift_rad}) < 0.1")
    page.until("Math.abs(window.armbridge.drawn.joint_stamp_s - window.armbridge.state().joints.stamp) < 1")


def test_a_named_pose_is_planned_looked_at_and_moved_to(page: OpenPage, server: RunningServer) -> None:
    move_to(server, "ready")
    page.part("named-home").click()
    page.press("plan")
    page.until_state("s.plan.trajectory !== null && s.plan.tool_path.length > 1")
    page.part("scrubber").fill("0.5")
    page.shot("planned")
    page.press("go")
    page.until_state("s.goal.code === 1")
    page.until_text("state-pill", "IDLE")


def test_the_target_is_dragged_and_the_arm_arrives(page: OpenPage, server: RunningServer) -> None:
    start_m = (0.25, 0.0, 0.2)
    type_target(page, start_m)
    page.until_state("s.target.reachable === true")
    foot, head = page.screen_of(start_m), page.screen_of((0.25, 0.0, 0.25))
    length = math.dist(foot, head)
    along = ((head[0] - foot[0]) / length, (head[1] - foot[1]) / length)
    mouse = page.page.mouse
    mouse.move(foot[0] + 45 * along[0], foot[1] + 45 * along[1])
    mouse.down()
    mouse.move(foot[0] + 70 * along[0], foot[1] + 70 * along[1], steps=5)
    mouse.up()
    page.until_state(f"s.target.position_m[2] > {start_m[2] + 0.005}")
    wished = page.state("target.position_m")
    assert wished[:2] == pytest.approx(start_m[:2], abs=1e-3)
    page.until_state("s.target.reachable === true && s.target.joints_rad !== null")
    page.shot("target")
    page.part("plan-and-move").click()
    page.until_state("s.goal.code === 1 && s.selection.kind === 'none'")
    assert math.dist(tip(server.url), wished) < ARRIVED_M


def test_a_target_out_of_reach_says_how_far(page: OpenPage) -> None:
    type_target(page, (0.6, 0.0, 0.3))
    page.until_state("s.target.reachable === false && s.target.distance_m > 0.1")
    page.shot("out_of_reach")


def test_a_refused_goal_shows_its_sentence(page: OpenPage) -> None:
    type_target(page, (0.9, 0.0, 0.3))
    page.part("plan-and-move").click()
    page.until_text("message", "NO_IK_SOLUTION")
    # In the units of the page, though the server's sentence is in metres and centimetres.
    page.until_text("message", "cannot reach (900, 0, 300) mm")
    page.until_text("message", "mm away")
    page.shot("refused")


@pytest.mark.parametrize("way", ["button", "Escape"])
def test_stop_ends_a_long_motion_and_is_acknowledged(page: OpenPage, server: RunningServer, way: str) -> None:
    move_to(server, "home")
    set_speed(page, 5)
    page.part("named-extended").click()
    page.part("plan-and-move").click()
    page.until_text("state-pill", "EXECUTING")
    page.until_state("s.goal.fraction > 0.02")
    if way == "button":
        page.part("stop").click()
    else:
        page.page.keyboard.press("Escape")
    page.until_acknowledged()
    page.until_text("state-pill", "STOPPED")
    page.until_state("s.arm.mode === 'holding'")
    page.shot("stopped")
    stands = page.joints()
    page.page.wait_for_timeout(300)
    assert page.joints() == pytest.approx(stands, abs=STILL_RAD)
    assert page.state("goal.fraction") < 0.9


def test_a_saved_pose_is_used_by_its_name(page: OpenPage, server: RunningServer) -> None:
    assert goal(server.url, "/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [0.5]})["val"] == 1
    page.part("save-name").fill("aside")
    page.part("save").click()
    page.part("named-aside").wait_for()
    move_to(server, "home")
    page.part("named-aside").click()
    page.part("plan-and-move").click()
    page.until_state("Math.abs(s.joints.position_rad[0] - 0.5) < 0.06")


def test_two_pages_follow_the_same_arm(browser: Browser, page: OpenPage, server: RunningServer) -> None:
    move_to(server, "home")
    page.part("save-name").fill("shared")
    page.part("save").click()
    page.part("named-shared").wait_for()
    with opened(browser) as second:
        second.open(server.port)
        second.until_state("'shared' in s.named && s.joints.names.length > 0")
        before = second.joints()["shoulder_lift"]
        page.part("named-ready").click()
        page.part("plan-and-move").click()
        page.until_state("s.goal.code === 1 && s.selection.kind === 'none'")
        goal_id = page.state("goal.id")
        second.until_state(f"s.goal_history.some(({{ goal }}) => goal.id === '{goal_id}' && goal.code === 1)")
        second.until_state(f"Math.abs(s.joints.position_rad[1] - {before}) > 0.1")
        second.until_text("state-pill", "IDLE")
        assert not second.errors


TENT = {
    "vertices": [{"x": x, "y": y, "z": z} for x, y, z in ((-0.05, -0.05, -0.05), (0.05, -0.05, -0.05), (0, 0, 0.05))],
    "triangles": [{"vertex_indices": [0, 1, 2]}, {"vertex_indices": [2, 1, 0]}],
}


BOX = {"type": 1, "dimensions": [0.1, 0.1, 0.1]}


@pytest.mark.parametrize("shape", [{"primitives": [BOX]}, {"meshes": [TENT]}], ids=["box", "mesh"])
def test_a_thing_of_the_planning_scene_is_drawn_where_it_is_until_it_is_removed(
    page: OpenPage, server: RunningServer, shape: dict[str, Any]
) -> None:
    place_m = (0.3, -0.15, 0.05)
    thing = {"id": "thing", "pose": {"position": dict(zip("xyz", place_m, strict=True))}, **shape}
    assert call(server.url, "/apply_planning_scene", scene_of(thing))["success"]
    page.until_colour(place_m, lambda red, green, blue: green > max(red, blue))
    page.shot("scene")
    assert call(server.url, "/apply_planning_scene", scene_of({"id": "thing", "operation": 1}))["success"]
    page.until_colour(place_m, lambda red, green, blue: green <= max(red, blue))


def scene_of(thing: dict[str, Any]) -> dict[str, Any]:
    return {"scene": {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": [thing]}}}


def test_after_all_of_this_nothing_went_wrong_in_the_page_nor_lies_over_stop(page: OpenPage) -> None:
    assert is_uncovered(page, "stop")
    assert page.errors == []
