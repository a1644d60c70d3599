"""The panel World: what is added there stands in the arm's way, is held, comes back, and shows where the arm can be."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from harness.clients import call
from harness.page import SHARED, OpenPage
from harness.server import FAST, RunningServer

# In front of the arm, within its reach.
PLACE_M = (0.25, 0.1, 0.0)

Scene = dict[str, dict[str, Any]]
Point = tuple[float, ...]


SETTINGS = {**FAST, **SHARED}


@pytest.fixture(scope="module")
def world(kept_page: OpenPage) -> OpenPage:
    kept_page.until_state("s.link.connected && s.identity !== null && s.editing.saved !== null")
    kept_page.open_panel("world")
    return kept_page


@pytest.fixture
def page(world: OpenPage, server: RunningServer) -> OpenPage:
    """The panel, with an empty scene."""
    assert call(server.url, "/apply_planning_scene", {"scene": {"is_diff": False}})["success"]
    world.until_state("s.objects.length === 0")
    return world


def add_by_click(page: OpenPage, kind: str, place_m: tuple[float, float, float]) -> None:
    count = len(page.state("objects"))
    page.part(f"shape-{kind}").check()
    page.part("place-object").click()
    page.page.mouse.click(*page.screen_of(place_m))
    page.until_state(f"s.objects.length === {count + 1}")


def select(page: OpenPage, name: str) -> None:
    if page.state("selected_object") != name:
        page.part(f"object-{name}").click()
    page.until_state(f"s.selected_object === '{name}'")


def scene(server: RunningServer) -> Scene:
    """The scene as the server has it: the objects of the world, and the held ones with their links."""
    told = call(server.url, "/get_planning_scene", {"components": {"components": 0}})["scene"]
    held = told["robot_state"]["attached_collision_objects"]
    return {
        "world": {each["id"]: each for each in told["world"]["collision_objects"]},
        "held": {each["object"]["id"]: each for each in held},
    }


def until_on_server(page: OpenPage, server: RunningServer, condition: Callable[[Scene], bool]) -> None:
    """Wait until the scene of the server is so."""
    page.wait(lambda: condition(scene(server)))


def check(server: RunningServer, position_m: tuple[float, float, float]) -> dict[str, Any]:
    """The server's answer to a point for the tip."""
    pose = {"position": dict(zip("xyz", position_m, strict=True)), "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    return call(server.url, "/check_goals", {"poses": [{"header": {"frame_id": ""}, "pose": pose}], "joints": []})[
        "results"
    ][0]


def test_an_object_that_is_added_by_a_click_blocks_a_goal_until_the_change_is_undone(
    page: OpenPage, server: RunningServer
) -> None:
    inside_m = (0.25, 0.1, 0.04)
    assert check(server, inside_m)["free"]
    add_by_click(page, "box", PLACE_M)
    position = scene(server)["world"]["box_1"]["pose"]["position"]
    assert [position[axis] for axis in "xyz"] == pytest.approx([0.25, 0.1, 0.04], abs=0.003)
    assert not check(server, inside_m)["free"]
    page.part("undo-scene").click()
    until_on_server(page, server, lambda scene: scene["world"] == {})
    assert check(server, inside_m)["free"]


def test_an_object_is_dragged_by_its_arrows(page: OpenPage, server: RunningServer) -> None:
    add_by_click(page, "box", PLACE_M)
    count = len(page.state("editing.history"))
    drag_from_middle(page, (0.25, 0.1, 0.04), (0.0, 0.0, 0.045), (0.0, 0.0, 0.05))
    until_on_server(page, server, lambda s: s["world"]["box_1"]["pose"]["position"]["z"] > 0.06)
    page.until_state(f"s.editing.history.length === {count + 1}")
    position = scene(server)["world"]["box_1"]["pose"]["position"]
    assert position["x"] == pytest.approx(0.25, abs=0.003)


def drag_from_middle(page: OpenPage, middle_m: Point, handle_m: Point, way_m: Point) -> None:
    """Drag the handle at a distance from an object's middle along a way."""
    start_m = tuple(a + b for a, b in zip(middle_m, handle_m, strict=True))
    end_m = tuple(a + b for a, b in zip(start_m, way_m, strict=True))
    mouse = page.page.mouse
    mouse.move(*page.screen_of(start_m))
    frames = page.page.evaluate("window.armbridge.drawn.frames")
    page.until(f"window.armbridge.drawn.frames > {frames}")
    mouse.down()
    mouse.move(*page.screen_of(end_m), steps=5)
    mouse.up()


def test_an_object_is_stood_on_another_and_edited(page: OpenPage, server: RunningServer) -> None:
    add_by_click(page, "box", PLACE_M)
    add_by_click(page, "cylinder", (0.25, 0.1, 0.08))
    assert scene(server)["world"]["cylinder_1"]["pose"]["position"]["z"] == pytest.approx(0.12, abs=0.003)
    page.enter("object-size-radius", "35")
    until_on_server(page, server, lambda s: s["world"]["cylinder_1"]["primitives"][0]["dimensions"] == [0.08, 0.035])
    page.enter("object-x", "310")
    until_on_server(page, server, lambda s: s["world"]["cylinder_1"]["pose"]["position"]["x"] == pytest.approx(0.31))
    page.enter("object-yaw", "90")
    until_on_server(
        page, server, lambda s: s["world"]["cylinder_1"]["pose"]["orientation"]["z"] == pytest.approx(0.7071, abs=1e-3)
    )
    page.enter("object-size-radius", "5000")
    page.until_text("object-size-radius-problem", "2000 mm")
    page.part("duplicate-object").click()
    until_on_server(page, server, lambda s: "cylinder_2" in s["world"])
    page.until_state("s.selected_object === 'cylinder_2'")
    page.enter("object-name", "cup")
    until_on_server(page, server, lambda s: sorted(s["world"]) == ["box_1", "cup", "cylinder_1"])
    page.part("remove-cup").click()
    until_on_server(page, server, lambda s: sorted(s["world"]) == ["box_1", "cylinder_1"])


def test_what_is_attached_moves_along_and_stays_where_it_is_put_down(page: OpenPage, server: RunningServer) -> None:
    add_by_click(page, "sphere", PLACE_M)
    at = scene(server)["world"]["sphere_1"]["pose"]["position"]
    page.part("attach-object").click()
    until_on_server(page, server, lambda s: s["world"] == {} and "sphere_1" in s["held"])
    held = scene(server)["held"]["sphere_1"]
    assert held["link_name"] == "gripper_frame_link"
    assert sorted(held["touch_links"]) == ["gripper_frame_link", "gripper_link", "moving_jaw_so101_v1_link"]
    page.until_text("objects", "held by gripper_frame_link")
    present = dict(page.joints())
    goal = {"joints": {"name": ["shoulder_pan"], "position": [present["shoulder_pan"] + 0.5]}}
    assert call(server.url, "/moveit_goal", goal)["success"]
    page.until(f"Math.abs({present['shoulder_pan'] + 0.5} - window.armbridge.state().joints.position_rad[0]) < 0.05")
    page.part("detach-object").click()
    until_on_server(page, server, lambda s: "sphere_1" in s["world"])
    now = scene(server)["world"]["sphere_1"]["pose"]["position"]
    assert max(abs(now[axis] - at[axis]) for axis in "xyz") > 0.03


def test_a_saved_scene_comes_back_from_the_server_and_from_a_file(
    page: OpenPage, server: RunningServer, tmp_path: Path
) -> None:
    add_by_click(page, "box", PLACE_M)
    page.part("section-saved-scenes").locator("summary").click()
    page.part("scene-name").fill("Küche")
    page.part("save-scene").click()
    page.until_text("saved-scenes", "Küche")
    file = page.download("download-scene", tmp_path)
    for bring_back in (
        lambda: page.part("load-scene-Küche").click(),
        lambda: page.part("scene-file").set_input_files(file),
    ):
        page.part("remove-box_1").click()
        until_on_server(page, server, lambda s: s["world"] == {})
        bring_back()
        until_on_server(page, server, lambda s: "box_1" in s["world"])
        page.until_state("s.objects.length === 1")
        select(page, "box_1")
    page.part("delete-scene-Küche").click()
    page.part("delete-scene-Küche").click()
    page.until_state("s.editing.saved.length === 0")
    assert call(server.url, "/arm/scenes/list", {})["names"] == []


STL = """solid part
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 60 0 0
vertex 0 60 40
endloop
endfacet
facet normal 0 0 1
outer loop
vertex 60 0 0
vertex 60 60 0
vertex 0 60 40
endloop
endfacet
endsolid part
"""


def test_a_mesh_file_is_added_and_one_of_100_mb_is_refused_before_it_is_read(
    page: OpenPage, server: RunningServer, tmp_path: Path
) -> None:
    page.part("shape-mesh").check()
    # A file without blocks on the disk: it would be slow to read, and is not.
    large = tmp_path / "large.stl"
    with large.open("wb") as file:
        file.truncate(100_000_000)
    forbid_reading = (
        "Blob.prototype.arrayBuffer = () => { window.was_read = true; return Promise.reject(new Error('')); }"
    )
    page.page.evaluate(f"() => {{ {forbid_reading} }}")
    page.part("mesh-file").set_input_files(large)
    page.until_text("mesh-result", "large.stl has 100 MB; the limit is 30 MB.")
    assert not page.page.evaluate("window.was_read === true")
    assert page.part("place-object").is_disabled()
    page.page.reload()
    page.until_state("s.link.connected && s.editing.saved !== null")
    page.part("shape-mesh").check()
    small = tmp_path / "Part 1.stl"
    small.write_text(STL)
    page.part("mesh-file").set_input_files(small)
    page.until_text("mesh-result", "2 triangles")
    page.part("add-object").click()
    until_on_server(page, server, lambda s: list(s["world"]) == ["Part_1"])
    part = scene(server)["world"]["Part_1"]
    assert len(part["meshes"][0]["vertices"]) == 4
    assert max(vertex["x"] for vertex in part["meshes"][0]["vertices"]) == pytest.approx(0.03)


def test_the_reachable_region_is_computed_anew_when_the_scene_changes(page: OpenPage, server: RunningServer) -> None:
    page.part("section-region").locator("summary").click()
    page.part("region-shown").check()
    # The first two passes, a quarter of the squares, are over the whole slice.
    page.until_state("s.region.total > 500 && s.region.cells.length > s.region.total / 4")
    before = page.state("region.cells")
    free_m = [cell["point_m"] for cell in before if cell["reach"] == "free"]
    assert len(free_m) > 50
    assert check(server, tuple(free_m[len(free_m) // 2]))["free"]
    # In the slice, where the tip could be: a square in it is now told to be blocked.
    x, y, z = next((x, y, z) for x, y, z in free_m if abs(x - 0.3) < 0.03 and abs(z - 0.04) < 0.04)
    page.part("shape-box").check()
    page.enter("place-y", "0")
    page.part("add-object").click()
    there = f"Math.hypot(c.point_m[0] - {x}, c.point_m[1] - {y}, c.point_m[2] - {z}) < 1e-6"
    page.until_state(f"s.region.cells.some(c => c.reach === 'contact' && {there})")
    page.part("region-shown").uncheck()
    page.until_state("s.region.cells.length === 0 && s.region.total === 0")


def test_a_scenario_is_there_by_one_press_and_is_put_back_by_reset(page: OpenPage, server: RunningServer) -> None:
    for name, count in (("table", 6), ("shelf", 6), ("cubes", 4)):
        page.part(f"scenario-{name}").click()
        page.until_state(f"s.objects.length === {count} && s.objects.every(object => object.color !== null)")
    begun = scene(server)
    select(page, "cube_red")
    page.enter("object-x", "150")
    page.wait(lambda: scene(server) != begun)
    page.part("scenario-reset").click()
    page.wait(lambda: scene(server) == begun)
    page.part("scenario-empty").click()
    page.until_state("s.objects.length === 0")
