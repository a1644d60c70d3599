"""Behaviour of the page on messages that no good server sends, put into the connection on their way."""

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.page import OpenPage, opened
from harness.server import RunningServer
from tests.helpers.robots import meshed_arm

HUGE_BYTES = 100_000_000


def change_topic(page: OpenPage, topic: str, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Have every message of a topic changed on its way to the page."""

    def changed(operation: dict[str, Any]) -> dict[str, Any]:
        if operation.get("op") == "publish" and operation["topic"] == topic:
            operation["msg"] = change(operation["msg"])
        return operation

    page.change_operations(changed)


@pytest.fixture(scope="module")
def module_page(browser: Browser) -> Iterator[OpenPage]:
    with opened(browser, draws=True, own=True) as open_page:
        yield open_page


@pytest.fixture
def page(module_page: OpenPage) -> Iterator[OpenPage]:
    yield module_page
    module_page.leave()


def notices(page: OpenPage) -> str:
    return " ".join(notice["text"] for notice in page.state("notices"))


@pytest.mark.parametrize("text", ["<robot", "", "<robot name='x'/>", "no XML at all"])
def test_a_urdf_that_does_not_parse_is_told(page: OpenPage, server: RunningServer, text: str) -> None:
    change_topic(page, "/robot_description", lambda msg: {"data": text})
    page.goto(server.port)
    page.until_state("s.notices.length > 0")
    assert re.search(r"URDF|description", notices(page))
    if text == "<robot":
        page.shot("bad_urdf")
    assert page.part("stop").is_visible()
    # The browser's own description of bad XML has a style that the page's policy does not let through.
    assert [error for error in page.errors if "inline style" not in error] == []


def test_a_mesh_that_is_missing_leaves_a_placeholder_and_a_message(page: OpenPage, server: RunningServer) -> None:
    def with_a_mesh(msg: dict[str, Any]) -> dict[str, Any]:
        mesh = '<geometry><mesh filename="package://nowhere/gone.stl"/></geometry>'
        return {"data": re.sub(r"<geometry>.*?</geometry>", mesh, msg["data"], count=1, flags=re.DOTALL)}

    change_topic(page, "/robot_description", with_a_mesh)
    page.open(server.port)
    page.until_state("s.notices.some(notice => notice.text.includes('gone.stl'))")
    page.shot("missing_mesh")


def test_a_mesh_of_100_mb_is_a_placeholder_and_a_message_on_a_page_that_works(
    browser: Browser, settings: dict[str, str], tmp_path: Path
) -> None:
    arm = meshed_arm(tmp_path, "huge.stl")
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate(HUGE_BYTES)
    with RunningServer(settings={**settings, **arm}) as server, opened(browser) as page:
        page.open(server.port)
        page.until_state("s.notices.some(notice => notice.text.includes('huge.stl: larger'))")
        page.stop()
        page.shot("huge_mesh")


def test_numbers_that_are_none_are_not_drawn(page: OpenPage, server: RunningServer) -> None:
    change_topic(page, "/joint_states", lambda msg: {**msg, "position": [None] * len(msg["position"])})
    page.open(server.port)
    page.until_state("s.notices.length > 0")
    assert "number" in notices(page)
    assert page.colours() > 50
    page.shot("no_numbers")
    assert page.errors == []


def test_joint_names_that_do_not_match_are_told_once(page: OpenPage, server: RunningServer) -> None:
    change_topic(page, "/joint_states", lambda msg: {**msg, "name": [f"other_{name}" for name in msg["name"]]})
    page.open(server.port)
    page.until_state("s.notices.some(notice => notice.text.includes('other_'))")
    assert len([notice for notice in page.state("notices") if "other_" in notice["text"]]) == 1
    page.shot("other_names")
    assert page.errors == []


def test_stop_does_not_hang_when_the_server_says_nothing(page: OpenPage, server: RunningServer) -> None:
    """As on a phone that slept: the connection is open, and nobody is at the other end."""
    silent = False
    page.change_operations(lambda operation: None if silent else operation)
    page.open(server.port)
    page.until_state("s.link.connected && s.joints.names.length > 0")
    silent = True
    page.part("stop").click()
    page.until_text("stop", "not acknowledged")
    page.shot("silent_server")
    silent = False
    page.until_state("s.link.connected")


def test_objects_of_a_scene_that_make_no_sense_do_not_stop_the_page(page: OpenPage, server: RunningServer) -> None:
    odd = {
        "id": "odd",
        "header": {"frame_id": "base_link"},
        "pose": {"position": {"x": None, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 0}},
        "primitives": [{"type": 99, "dimensions": []}, {"type": 1, "dimensions": [-1.0]}],
        "primitive_poses": [],
        "meshes": [{"triangles": [{"vertex_indices": [0, 1, 7]}], "vertices": []}],
        "mesh_poses": [],
        "planes": [{"coef": [0, 0, 0, 0]}],
        "plane_poses": [],
        "operation": 0,
    }

    def with_odd(msg: dict[str, Any]) -> dict[str, Any]:
        return {**msg, "world": {**msg.get("world", {}), "collision_objects": [odd]}}

    change_topic(page, "/monitored_planning_scene", with_odd)
    page.open(server.port)
    page.until_state("s.joints.names.length > 0")
    page.until("window.armbridge.drawn.frames > 3")
    assert page.colours() > 50
    assert all(math.isfinite(value) for value in page.joints().values())
    assert page.errors == []
