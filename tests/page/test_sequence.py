"""The panel Sequence: waypoints are added, checked while they are edited, played, kept by name, and exported."""

import json
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser
from websockets.sync.client import connect

from harness.clients import call, tip
from harness.page import PATIENCE_MS, SHARED, OpenPage, opened
from harness.server import FAST, ROOT, RunningServer
from tests.helpers.programs import run

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")

Positions = dict[str, float]

PLACES: tuple[Positions, ...] = tuple(
    dict(zip(JOINTS, values, strict=True))
    for values in ((0.4, -0.5, 0.5, 0.3, 0.0), (-0.4, -0.3, 0.5, 0.2, 0.2), (0.0, -0.8, 0.8, 0.4, 0.0))
)

# The lower arm in the shoulder.
COLLIDING = dict(zip(JOINTS, (0.0, 1.7, 1.6, 0.0, 0.0), strict=True))

# The arm's own goal tolerance, and the droop of a simulated arm.
NEAR_RAD = 0.06

PATIENCE_S = PATIENCE_MS / 1e3

SETTINGS = {**FAST, **SHARED}


@pytest.fixture(scope="module")
def panel(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser) as open_page:
        open_sequence(open_page, server)
        yield open_page
        assert open_page.errors == []


@pytest.fixture
def page(panel: OpenPage, server: RunningServer) -> OpenPage:
    """The panel, with an empty scene and no waypoints."""
    assert call(server.url, "/apply_planning_scene", {"scene": {"is_diff": False}})["success"]
    panel.open_panel("sequence")
    load(panel)
    panel.until_state("s.objects.length === 0 && s.sequence.checks.length === 0")
    return panel


def open_sequence(page: OpenPage, server: RunningServer) -> None:
    page.open(server.port)
    page.until_state("s.link.connected && s.identity !== null && s.robot !== null")
    page.open_panel("sequence")


def move(server: RunningServer, place: Positions) -> None:
    goal = {"joints": {"name": list(place), "position": list(place.values())}, "velocity_scaling": 1.0}
    answer = call(server.url, "/moveit_goal", goal)
    assert answer["success"], answer


def is_near(positions: Positions, place: Positions) -> bool:
    return all(abs(positions[name] - value) < NEAR_RAD for name, value in place.items())


def add_places(page: OpenPage, server: RunningServer, *places: Positions) -> None:
    """Move the arm to places and add each where the arm is."""
    for place in places:
        move(server, place)
        wanted = " && ".join(
            f"Math.abs(s.joints.position_rad[s.joints.names.indexOf('{name}')] - {value}) < {NEAR_RAD}"
            for name, value in place.items()
        )
        page.until_state(wanted)
        count = len(page.state("sequence.waypoints"))
        page.part("add-here").click()
        page.until_state(f"s.sequence.waypoints.length === {count + 1}")


def choose_file(page: OpenPage, name: str, text: str) -> None:
    page.part("sequence-file").set_input_files({"name": name, "mimeType": "application/json", "buffer": text.encode()})


def load(page: OpenPage, *waypoints: dict[str, Any]) -> None:
    """Load a sequence from a file."""
    choose_file(page, "s.json", json.dumps({"waypoints": waypoints}))
    page.until_state(f"s.sequence.waypoints.length === {len(waypoints)}")


def until_checked(page: OpenPage, *verdicts: str) -> None:
    page.until_state(f"s.sequence.checks.map(c => c.verdict).join() === {','.join(verdicts)!r}")


@contextmanager
def watched(server: RunningServer) -> Iterator[Callable[[Callable[[list[Positions]], bool]], None]]:
    """Listen to the server's joint states; gives a wait for what they tell since the beginning."""
    seen: list[Positions] = []
    news = threading.Condition()

    def listen() -> None:
        for frame in websocket:
            message = json.loads(frame)["msg"]
            with news:
                seen.append(dict(zip(message["name"], message["position"], strict=True)))
                news.notify_all()

    def until(condition: Callable[[list[Positions]], bool]) -> None:
        with news:
            assert news.wait_for(lambda: condition(seen), PATIENCE_S), seen[-1:]

    with connect(server.url) as websocket:
        websocket.send(json.dumps({"op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState"}))
        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        yield until


def went_through(*places: Positions) -> Callable[[list[Positions]], bool]:
    """Condition that the arm was at each place, in this order."""

    def check(seen: list[Positions]) -> bool:
        wanted = list(places)
        for positions in seen:
            if wanted and is_near(positions, wanted[0]):
                wanted.pop(0)
        return not wanted

    return check


def waypoint(place: Positions, **fields: Any) -> dict[str, Any]:
    return {"joints_rad": place, "speed": 1.0, **fields}


def test_the_arm_goes_through_the_waypoints_in_their_order(page: OpenPage, server: RunningServer) -> None:
    add_places(page, server, *PLACES)
    with watched(server) as until:
        page.part("play-sequence").click()
        until(went_through(*PLACES))
    page.until_text("sequence-told", "The sequence is done, 3 waypoints.")
    assert page.state("sequence.playing") is None


def test_waypoints_are_reordered_by_buttons_and_by_dragging(page: OpenPage) -> None:
    load(page, *(waypoint(place) for place in PLACES))
    page.part("waypoint-3-up").click()
    page.until_state("s.sequence.waypoints.map(w => w.id).join() === '1,3,2'")
    assert page.page.evaluate("document.activeElement.dataset.testid") == "waypoint-3-up"
    page.part("waypoint-1-down").press("Enter")
    page.until_state("s.sequence.waypoints.map(w => w.id).join() === '3,1,2'")
    page.part("waypoint-2-handle").drag_to(page.part("waypoint-3"))
    page.until_state("s.sequence.waypoints.map(w => w.id).join() === '2,3,1'")
    page.part("waypoint-3-remove").click()
    page.until_state("s.sequence.waypoints.map(w => w.id).join() === '2,1'")


def test_the_target_is_added_as_a_waypoint(page: OpenPage) -> None:
    load(page, waypoint(PLACES[0]))
    assert page.part("add-goal").is_disabled()
    page.part("waypoint-1-show").click()
    page.until_state("s.selection.kind === 'joints'")
    page.part("add-goal").click()
    page.until_state("s.sequence.waypoints.length === 2")
    assert page.state("sequence.waypoints[1].joints_rad") == PLACES[0]


def test_a_leg_into_a_contact_names_the_links_and_nothing_is_played(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[2])
    load(page, waypoint(PLACES[0]), waypoint(COLLIDING), waypoint(PLACES[1]))
    until_checked(page, "possible", "refused", "unknown")
    page.until_text("waypoint-2-check", "shoulder_link and lower_arm_link")
    page.part("play-sequence").click()
    page.until_text("sequence-told", "Nothing was moved")
    page.until_text("sequence-told", "shoulder_link and lower_arm_link")
    positions = call(server.url, "/get_planning_scene", {"components": {"components": 2}})["scene"]["robot_state"]
    state = positions["joint_state"]
    assert is_near(dict(zip(state["name"], state["position"], strict=True)), PLACES[2])


def test_an_object_that_comes_into_the_way_is_told_at_once(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[1])
    x, y, z = tip(server.url)
    move(server, PLACES[2])
    page.until_state("s.arm.mode === 'holding'")
    load(page, waypoint(PLACES[1]))
    until_checked(page, "possible")
    box = {
        "id": "crate",
        "header": {"frame_id": "base_link"},
        "primitives": [{"type": 1, "dimensions": [0.05, 0.05, 0.05]}],
        "primitive_poses": [{"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}],
        "operation": 0,
    }
    scene = {"is_diff": True, "world": {"collision_objects": [box]}, "robot_state": {"is_diff": True}}
    assert call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    until_checked(page, "refused")
    page.until_text("waypoint-1-check", "crate")


def test_checks_are_not_shown_as_plans_to_carry_out(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[2])
    page.until_state("s.arm.mode === 'holding'")
    goal = {"joints": {"name": list(PLACES[0]), "position": list(PLACES[0].values())}, "plan_only": True}
    assert call(server.url, "/moveit_goal", goal)["success"]
    page.until_state("s.plan.trajectory !== null")
    page.open_panel("move")
    page.part("forget-wish").click()
    page.until_state("s.plan.trajectory === null")
    page.open_panel("sequence")
    load(page, waypoint(PLACES[0]), waypoint(PLACES[1]))
    until_checked(page, "possible", "possible")
    # What the server tells about the other topics after the checks comes after their plans, too.
    stamp = page.state("joints.stamp")
    page.until_state(f"s.joints.stamp > {stamp}")
    assert page.state("plan.trajectory") is None


def test_a_sequence_is_stopped_on_its_way_and_in_a_pause(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[2])
    load(page, waypoint(PLACES[0], speed=0.05), waypoint(PLACES[1]))
    page.part("play-sequence").click()
    page.until_state("s.sequence.playing?.doing === 'motion' && s.arm.mode === 'moving'")
    page.part("stop-sequence").click()
    page.until_text("sequence-told", "The sequence was stopped.")
    page.until_state("s.arm.mode === 'holding'")
    load(page, waypoint(PLACES[2], pause_s=600), waypoint(PLACES[1]))
    page.part("play-sequence").click()
    page.until_state("s.sequence.playing?.doing === 'pause'")
    assert page.part("waypoint-1").get_attribute("aria-current") == "step"
    page.part("stop").click()
    page.until_text("sequence-told", "The sequence was stopped.")
    assert is_near(page.joints(), PLACES[2])


def test_the_stop_of_another_client_ends_a_wait(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[2])
    load(page, waypoint(PLACES[2], pause_s=600), waypoint(PLACES[1]))
    page.part("play-sequence").click()
    page.until_state("s.sequence.playing?.doing === 'pause'")
    with connect(server.url) as other:
        other.send(json.dumps({"op": "publish", "topic": "/stop", "type": "std_msgs/Empty", "msg": {}}))
        page.until_text("sequence-told", "The sequence was stopped.")
    assert is_near(page.joints(), PLACES[2])


def test_a_sequence_is_kept_by_name_over_a_reload(page: OpenPage, server: RunningServer) -> None:
    load(page, waypoint(PLACES[0]), waypoint(PLACES[1], straight=True, pause_s=1.5))
    page.part("sequence-name").fill("wave")
    page.part("save-sequence").click()
    page.until_text("sequence-told", "“wave” is saved")
    page.open(server.port)
    page.open_panel("sequence")
    page.part("load-sequence-wave").click()
    page.until_state("s.sequence.waypoints.length === 2 && s.sequence.waypoints[1].pause_s === 1.5")
    assert page.state("sequence.waypoints[1].straight") is True
    # A double click asks only.
    page.part("delete-sequence-wave").dblclick()
    page.until_text("delete-sequence-wave", "Really delete?")
    page.part("sequence-name").focus()
    page.until_text("delete-sequence-wave", "Delete")
    assert list(page.state("sequence.saved")) == ["wave"]
    page.part("delete-sequence-wave").click()
    page.part("delete-sequence-wave").click()
    page.until_state("Object.keys(s.sequence.saved).length === 0")


def test_a_sequence_has_pictures_path_and_time_and_is_there_again_after_a_reload(
    browser: Browser, server: RunningServer
) -> None:
    move(server, PLACES[2])
    with opened(browser, draws=True) as page:
        open_sequence(page, server)
        load(page, waypoint(PLACES[0]), waypoint(PLACES[1], pause_s=1.5))
        for _ in range(2):
            until_checked(page, "possible", "possible")
            page.until_text("sequence-total", "s in all")
            total_s = float((page.part("sequence-total").text_content() or "").split()[0])
            moving_s = sum(check["duration_s"] for check in page.state("sequence.checks"))
            assert total_s == pytest.approx(moving_s + 1.5, abs=0.06)
            page.until_state("Object.keys(s.thumbnails).length === 2 && s.plan.tool_path.length > 20")
            pictures = page.page.evaluate("[...document.querySelectorAll('.thumbnail')].map(each => each.src)")
            assert len(set(pictures)) == 2
            assert all(picture.startswith("data:image/png") for picture in pictures)
            page.open(server.port)
            page.open_panel("sequence")


def test_a_strip_below_the_picture_shows_how_far_the_gripper_is_open(page: OpenPage) -> None:
    load(page, *map(waypoint, PLACES))
    page.part("waypoint-2-gripper").select_option("open")
    page.part("waypoint-3-gripper").select_option("closed")
    page.part("waypoint-2-strip").wait_for()
    assert page.part("waypoint-1-strip").count() == 0
    assert [page.part(f"waypoint-{number}-strip").get_attribute("aria-label") for number in (2, 3)] == [
        "Gripper 100 % open",
        "Gripper 0 % open",
    ]
    picture, strip = page.box("waypoint-2-show"), page.box("waypoint-2-strip")
    assert strip["y"] >= picture["y"] + picture["height"]
    assert strip["width"] == picture["width"]
    page.part("waypoint-3-gripper").select_option("leave")
    page.until("document.querySelector('[data-testid=waypoint-3-strip]')?.ariaLabel === 'Gripper 100 % open'")


def test_a_sequence_is_repeated_until_it_is_stopped(page: OpenPage, server: RunningServer) -> None:
    move(server, PLACES[2])
    load(page, waypoint(PLACES[0]), waypoint(PLACES[1]))
    page.part("sequence-loop").check()
    with watched(server) as until:
        page.part("play-sequence").click()
        until(went_through(PLACES[0], PLACES[1], PLACES[0], PLACES[1]))
        page.part("stop").click()
    page.until_text("sequence-told", "The sequence was stopped.")
    page.part("sequence-loop").uncheck()


def test_a_file_that_is_no_sequence_says_so_and_changes_nothing(page: OpenPage) -> None:
    load(page, waypoint(PLACES[0]))
    choose_file(page, "a.json", "{}")
    page.until_text("sequence-told", "a.json holds no sequence")
    assert len(page.state("sequence.waypoints")) == 1


def test_axe_finds_nothing_among_waypoints(page: OpenPage) -> None:
    load(page, waypoint(PLACES[0]), waypoint(COLLIDING), waypoint(PLACES[1]))
    until_checked(page, "possible", "refused", "unknown")
    assert page.violations() == []


def exported(page: OpenPage, language: str, folder: Path) -> Path:
    """Export a sequence with everything that one can have: a straight leg, the gripper, and a pause."""
    straight = waypoint(PLACES[1], straight=True, gripper=1.0, pause_s=0.1, name='the "second"')
    load(page, waypoint(PLACES[0]), straight, waypoint(PLACES[2]))
    return page.download(f"export-{language}", folder)


def run_program(server: RunningServer, *command: str) -> None:
    """Run an exported program, and see the arm go through the waypoints."""
    move(server, PLACES[2])
    with watched(server) as until:
        done = run(*command, timeout_s=PATIENCE_S)
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == ["1", 'the "second"', "3"]
        # The tip ends a straight leg in the nearest orientation, so that joints may differ there.
        until(went_through(PLACES[0], {"gripper": 1.0}, PLACES[2]))


def test_the_exported_python_program_moves_the_arm(page: OpenPage, server: RunningServer, tmp_path: Path) -> None:
    pytest.importorskip("roslibpy")
    run_program(server, sys.executable, str(exported(page, "python", tmp_path)))


def test_the_exported_javascript_program_moves_the_arm(page: OpenPage, server: RunningServer, tmp_path: Path) -> None:
    modules = ROOT / "server" / "page" / "node_modules"
    if shutil.which("node") is None or not (modules / "roslib").exists():
        pytest.skip("node or roslib is not installed (make page)")
    (tmp_path / "node_modules").symlink_to(modules)
    run_program(server, "node", str(exported(page, "javascript", tmp_path)))


def test_a_program_ends_with_the_reason_when_a_leg_is_not_possible(
    page: OpenPage, server: RunningServer, tmp_path: Path
) -> None:
    pytest.importorskip("roslibpy")
    load(page, waypoint(COLLIDING))
    program = page.download("export-python", tmp_path)
    done = run(sys.executable, program, server.url, timeout_s=PATIENCE_S)
    assert done.returncode == 1
    assert "shoulder_link and lower_arm_link" in done.stderr
    # A sentence, without a traceback.
    assert len(done.stderr.splitlines()) == 1, done.stderr
