"""The picture of the page: shadow, framing, reach, handles beside the gripper, and no frame without need."""

import io
import math
from collections.abc import Iterator

import pytest
from PIL import Image
from playwright.sync_api import Browser

from harness.clients import goal
from harness.page import DESKTOP, PHONE, SHARED, OpenPage, opened
from harness.server import RunningServer

Point = tuple[float, float, float]


# On the ground in the shadow of the stretched arm, and where no shadow falls; both within its reach.
SHADED_M: Point = (0.2, 0.09, 0.0)
LIT_M: Point = (0.12, -0.22, 0.0)

SETTINGS = SHARED


@pytest.fixture(scope="module")
def page(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, draws=True, color_scheme="light") as open_page:
        open_page.open(server.port)
        yield open_page


def brightness(page: OpenPage, position_m: Point) -> float:
    """Return the mean brightness around a point of the root link's frame (0 to 255), over the lines of the grid."""
    x, y = page.screen_of(position_m)
    picture = page.page.screenshot(clip={"x": x - 5, "y": y - 5, "width": 11, "height": 11})
    values = Image.open(io.BytesIO(picture)).convert("L").tobytes()
    return sum(values) / len(values)


def test_the_arm_casts_a_shadow_on_the_ground(page: OpenPage) -> None:
    page.until("window.armbridge.drawn.frames > 2")
    page.shot("look")
    shaded, lit = brightness(page, SHADED_M), brightness(page, LIT_M)
    assert shaded < lit - 15


def test_nothing_is_drawn_while_nothing_changes(page: OpenPage) -> None:
    stamp_s = page.page.evaluate("window.armbridge.drawn.joint_stamp_s")
    # The last frame of what went before may be under way.
    page.until(f"window.armbridge.drawn.joint_stamp_s > {stamp_s + 3}")
    before = page.page.evaluate("window.armbridge.drawn")
    page.until(f"window.armbridge.drawn.joint_stamp_s > {before['joint_stamp_s'] + 1}")
    assert page.page.evaluate("window.armbridge.drawn.frames") == before["frames"]


def test_the_reach_shows_while_a_handle_is_under_the_pointer(page: OpenPage) -> None:
    quiet = brightness(page, LIT_M)
    x, y = page.screen_of(tuple(page.state("tool_m")))
    page.page.mouse.move(x, y - 80)
    page.until("window.armbridge.drawn.frames > 0")
    page.wait(lambda: brightness(page, LIT_M) < quiet - 4)
    page.shot("look_reach")
    page.page.mouse.move(20, 300)


def test_the_ball_at_the_gripper_is_dragged_in_the_plane_of_the_picture(page: OpenPage) -> None:
    page.part("forget-wish").click()
    start = page.state("tool_m")
    x, y = page.screen_of(tuple(start))
    mouse = page.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x - 30, y - 40, steps=5)
    mouse.up()
    wished = page.state("target.position_m")
    assert math.dist(wished, start) > 0.02
    assert page.screen_of(tuple(wished)) == pytest.approx((x - 30, y - 40), abs=3)
    # The ghost follows as far as the arm can.
    page.until_state("s.target.joints_rad !== null")
    # Outside of Move there is no ball: the same drag turns the view.
    page.part("forget-wish").click()
    page.open_panel("world")
    x, y = page.screen_of(tuple(start))
    mouse.move(x, y)
    mouse.down()
    mouse.move(x - 30, y - 40, steps=5)
    mouse.up()
    assert page.state("selection.kind") == "none"
    assert page.screen_of(tuple(start)) != pytest.approx((x, y), abs=3)
    page.open_panel("move")
    page.page.mouse.move(20, 300)


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_whole_arm_is_well_in_the_picture(browser: Browser, server: RunningServer, size: tuple[int, int]) -> None:
    with opened(browser, size, draws=True, color_scheme="dark") as page:
        page.open(server.port)
        page.shot(f"look_dark_{size[0]}")
        box = page.page.locator("#view").bounding_box()
        assert box is not None
        foot, tool = page.screen_of((0.0, 0.0, 0.0)), page.screen_of(tuple(page.state("tool_m")))
        for x, y in (foot, tool):
            assert box["x"] < x < box["x"] + box["width"]
            assert box["y"] < y < box["y"] + box["height"]
        assert math.dist(foot, tool) > 0.3 * min(box["width"], box["height"])


LATE_FRAMES = """
const request = window.requestAnimationFrame;
window.requestAnimationFrame = (draw) => setTimeout(() => request(draw), 100);
window.least_pixels = Infinity;
setInterval(() => {
    const { width = Infinity, height = 1 } = document.querySelector("#view") ?? {};
    window.least_pixels = Math.min(window.least_pixels, width * height);
}, 20);
"""


def test_frames_that_come_late_have_fewer_pixels_until_the_arm_rests(browser: Browser, server: RunningServer) -> None:
    with opened(browser, draws=True, own=True) as page:
        page.page.add_init_script(LATE_FRAMES)
        page.open(server.port)
        # Without the canvas that was not laid out yet.
        page.page.evaluate("window.least_pixels = Infinity")
        for pose in ("ready", "home"):
            assert goal(server.url, "/moveit_goal_named", {"data": pose})["val"] == 1
        page.until("window.least_pixels < 100_000")
        page.until("document.querySelector('#view').width === document.querySelector('#view').clientWidth")
