"""Pictures of the page for the documentation: ``make pictures`` copies them to docs/pictures."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import call, goal
from harness.page import DESKTOP, PHONE, SHOTS, OpenPage, opened, page_digest
from harness.server import RunningServer

TABLET = (820, 1180)
SIZES = {"desktop": DESKTOP, "tablet": TABLET, "phone": PHONE}

PICTURES = SHOTS / "pictures"

# A repository keeps every version of a picture.
MAX_BYTES = 150_000

# Enough for a page of few colours and a shaded arm.
COLOURS = 256

# A change of size or colours is drawn in the frame after it.
AFTER_FRAMES = """async () => {
    for (let frame = 0; frame < 3; frame += 1) await new Promise(requestAnimationFrame);
}"""

BOX = {
    "id": "box",
    "primitives": [{"type": 1, "dimensions": [0.05, 0.05, 0.08]}],
    "pose": {"position": {"x": 0.25, "y": -0.18, "z": 0.04}},
}


@pytest.fixture(scope="module")
def page(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    """A page that shows a planned motion beside a box."""
    scene = {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": [BOX]}}
    assert call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    with opened(browser, draws=True, locale="en") as open_page:
        open_page.open(server.port)
        open_page.part("named-ready").click()
        open_page.press("plan")
        open_page.until_state("s.plan.trajectory !== null && s.plan.tool_path.length > 1")
        yield open_page


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("device", SIZES)
def test_the_page_is_pictured(page: OpenPage, device: str, scheme: Any) -> None:
    width, height = SIZES[device]
    page.page.set_viewport_size({"width": width, "height": height})
    page.page.emulate_media(color_scheme=scheme)
    page.page.evaluate(AFTER_FRAMES)
    # What has just changed is drawn with fewer pixels at first.
    page.until("(() => { const view = document.querySelector('#view'); return view.width === view.clientWidth; })()")
    picture = reduced(page.shot(f"page_{device}_{scheme}"), PICTURES / f"{device}_{scheme}.png")
    assert picture.stat().st_size <= MAX_BYTES
    assert page.page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.errors == []


def reduced(shot: Path, path: Path) -> Path:
    """Save a screenshot with few colours."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.open(shot).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


# The film of the README: width and height [px], what it may weigh, and how long it may last [s].
FILM = (800, 500)
MAX_FILM_BYTES = 600_000

# Frames that follow each other faster are left out.
MIN_FRAME_S = 0.08

# Time in which a viewer sees what was pressed, and its effect.
LOOK_MS = 600

# The arm stands on one side of a wall, and the named pose is on the other.
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
START = (0.6, 0.6, -0.2, 0.2, 0.0)
SHELF = (-0.7, 0.6, -0.2, 0.2, 0.0)
WALL = {
    "id": "wall",
    "primitives": [{"type": 1, "dimensions": [0.2, 0.03, 0.15]}],
    "pose": {"position": {"x": 0.33, "y": 0.0, "z": 0.075}},
}

# Done by the page itself: on a busy machine the motion would have ended when a test presses the button.
STOP_HALFWAY = """() => {
    const look = () => {
        if (window.armbridge.state().joints.position_rad[0] > 0.1) setTimeout(look, 20);
        else document.querySelector("[data-testid='stop']").click();
    };
    look();
}"""


@contextmanager
def filmed(page: OpenPage) -> Iterator[list[tuple[float, bytes]]]:
    """Keep the frames of a page as the browser draws them, as PNG, each with its time [s]."""
    frames: list[tuple[float, bytes]] = []
    session = page.page.context.new_cdp_session(page.page)

    def keep(event: dict[str, Any]) -> None:
        frames.append((event["metadata"]["timestamp"], base64.b64decode(event["data"])))
        session.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})

    session.on("Page.screencastFrame", keep)
    session.send("Page.startScreencast", {"format": "png"})
    yield frames
    session.send("Page.stopScreencast")


def save_film(frames: list[tuple[float, bytes]], path: Path) -> None:
    """Save frames as they followed each other, in the size of the README."""
    from PIL import Image

    kept = frames[:1]
    for frame in frames:
        if frame[0] - kept[-1][0] >= MIN_FRAME_S:
            kept.append(frame)
    first, *others = [Image.open(io.BytesIO(data)).convert("RGB").resize(FILM) for _, data in kept]
    durations_ms = [round(1e3 * (after_s - before_s)) for (before_s, _), (after_s, _) in pairwise(kept)]
    path.parent.mkdir(parents=True, exist_ok=True)
    # The last frame stays for a while before the film begins again.
    durations_ms.append(1500)
    first.save(path, save_all=True, append_images=others, duration=durations_ms, loop=0, quality=60, method=6)


def test_the_film_of_the_readme_shows_a_plan_a_motion_and_a_stop(browser: Browser, server: RunningServer) -> None:
    scene = {"is_diff": False, "robot_state": {"is_diff": True}, "world": {"collision_objects": [WALL]}}
    assert call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    assert goal(server.url, "/moveit_goal_joints", {"name": JOINTS, "position": START})["val"] == 1
    shelf = {"joint_state": {"name": JOINTS, "position": SHELF}}
    assert call(server.url, "/save_robot_state", {"name": "shelf", "state": shelf})["success"]
    with opened(browser, draws=True, locale="en", color_scheme="light") as page:
        page.open(server.port)
        page.part("named-shelf").wait_for()
        page.page.mouse.move(450, 400)
        page.page.mouse.wheel(0, 350)
        page.page.wait_for_timeout(2000)
        with filmed(page) as frames:
            page.page.wait_for_timeout(LOOK_MS)
            page.part("named-shelf").click()
            page.page.wait_for_timeout(LOOK_MS)
            page.press("plan")
            page.until_state("s.plan.trajectory !== null && s.plan.tool_path.length > 1")
            page.part("replay").click()
            page.until_state("!s.plan.replaying")
            page.page.wait_for_timeout(LOOK_MS)
            page.page.evaluate(STOP_HALFWAY)
            page.press("go")
            page.until_text("state-pill", "STOPPED")
            page.page.wait_for_timeout(LOOK_MS)
        assert page.errors == []
    film = PICTURES / "film.webp"
    save_film(frames, film)
    assert film.stat().st_size <= MAX_FILM_BYTES
    # tests/test_docs.py compares it with the page.
    (PICTURES / "page.sha256").write_text(page_digest() + "\n")
