"""Pictures of the page for its documentation: ``make pictures`` copies them to docs/pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.helpers.clients import call
from tests.helpers.page import DESKTOP, PHONE, SHOTS, OpenPage, opened
from tests.helpers.server import RunningServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

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
    with opened(browser, locale="en") as open_page:
        open_page.open(server.port)
        open_page.part("named-ready").click()
        open_page.part("plan").click()
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
