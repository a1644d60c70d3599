"""The page at every size, in both languages: nothing cut off, nothing on top of another, and the picture first."""

import json
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from harness.clients import goal
from harness.page import DESKTOP, LYING_PHONE, PHONE, SIZES, OpenPage, opened
from harness.server import RunningServer

# The lower arm in the shoulder, and MoveIt's code for it.
COLLIDING = {"name": ["shoulder_lift", "elbow_flex", "wrist_flex"], "position": [1.7, 1.6, 0.0]}
GOAL_IN_COLLISION = -12

# A row of the bar with the button to stop, and two rows of a thumb's size on a tablet or phone.
MAX_BAR_PX = {size: 124 if size in (PHONE, (820, 1180)) else 64 for size in SIZES}

# Thirty letters stand beside each other.
LEAST_SENTENCE_PX = 180

# Texts of controls that their box cuts off, panels and tables that scroll sideways, and what leaves the window.
FIND_CUT = """() => {
    const kinds = "button, summary, h2, .panel, .wide, #bar, #rail, #dock > section, .transport, .first-motion";
    const shown = [...document.querySelectorAll(kinds)].filter(each => each.checkVisibility());
    return shown.filter(each => {
        const { left, right } = each.getBoundingClientRect();
        const cut = each.scrollWidth > each.clientWidth + 1 && getComputedStyle(each).display !== "inline";
        const high = each.id === "bar" && each.scrollHeight > each.clientHeight + 1;
        return cut || high || left < -0.5 || right > innerWidth + 0.5;
    }).map(each => `${each.dataset.testid || each.id || each.className}: ${each.textContent.slice(0, 30)}`);
}"""

# Pairs of things above the picture that cover each other.
FIND_COVERED = """() => {
    const above = [...document.querySelectorAll("#stop, #bar, #rail, #dock > section, .transport, .first-motion")]
        .filter(each => each.checkVisibility() && !each.matches("#panel-drive"));
    const boxes = above.map(each => [each.id || each.className, each.getBoundingClientRect()]);
    return boxes.flatMap(([name, one], index) => boxes.slice(index + 1).filter(([, other]) =>
        one.left < other.right - 1 && other.left < one.right - 1 && one.top < other.bottom - 1
        && other.top < one.bottom - 1).map(([other]) => `${name} and ${other}`));
}"""


# What phones and tablets have.
TOUCH = {"has_touch": True, "is_mobile": True}


@pytest.fixture(scope="module", params=[{}, {"locale": "de"}], ids=["en", "de"])
def page(browser: Browser, server: RunningServer, request: pytest.FixtureRequest) -> Iterator[OpenPage]:
    with opened(browser, **request.param) as open_page:
        open_page.open(server.port)
        open_page.until_state("s.identity !== null && s.servos.length > 0")
        # The bar is fullest where it offers another goal beside a long sentence.
        assert goal(server.url, "/moveit_goal_joints", COLLIDING)["val"] == GOAL_IN_COLLISION
        open_page.part("suggestion").wait_for()
        yield open_page


IN_ENGLISH = pytest.mark.parametrize("page", [{}], ids=["en"], indirect=True)


@pytest.mark.parametrize("size", SIZES, ids=[f"{width}x{height}" for width, height in SIZES])
def test_nothing_is_cut_off_or_covered_in_any_panel(page: OpenPage, size: tuple[int, int]) -> None:
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    assert page.box("message")["width"] > LEAST_SENTENCE_PX
    found = {}
    for panel in page.open_panels():
        for name, find in (("cut", FIND_CUT), ("covered", FIND_COVERED)):
            if problems := page.page.evaluate(find):
                found[f"{panel} {name}"] = problems
    assert found == {}, json.dumps(found, indent=1)
    view = page.page.evaluate(
        "(({ clientWidth, clientHeight }) => [clientWidth, clientHeight])(document.querySelector('#view'))"
    )
    assert tuple(view) == size


@IN_ENGLISH
def test_the_picture_moves_aside_for_a_panel_and_comes_back(page: OpenPage) -> None:
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    page.open_panel("move")
    page.part("close-panel-move").click()
    page.open_panel("move")
    beside = page.screen_of((0.0, 0.0, 0.1))[0]
    page.part("close-panel-move").click()
    page.wait(lambda: page.screen_of((0.0, 0.0, 0.1))[0] > beside + 50)
    page.open_panel("move")
    page.wait(lambda: abs(page.screen_of((0.0, 0.0, 0.1))[0] - beside) < 2)


@IN_ENGLISH
def test_the_tour_has_four_steps(page: OpenPage) -> None:
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    page.open_panel("settings")
    page.part("tour-start").click()
    pointed_at = "[...document.querySelectorAll('.pointed-at')].map(each => each.id || each.className).join()"
    for step, target in enumerate(("view", "transport pointed-at", "stop", "rail"), 1):
        assert (page.part("tour-text").text_content() or "").startswith(f"{step} of 4")
        assert page.page.evaluate(pointed_at) == target
        page.part("tour-next").click()
    assert not page.part("tour").is_visible()
    assert page.page.evaluate(pointed_at) == ""


@pytest.mark.parametrize("size", SIZES, ids=[f"{width}x{height}" for width, height in SIZES])
def test_bar_stop_and_rail_stay_in_their_place_and_nothing_is_covered_while_the_arm_moves(
    browser: Browser, server: RunningServer, size: tuple[int, int]
) -> None:
    with opened(browser, size, **(TOUCH if size[0] < 1000 else {})) as page:
        page.open(server.port)
        # A small screen begins with the picture alone.
        assert page.part("panel-move").is_visible() is (min(size) > 500)
        assert page.page.evaluate("document.querySelector('#bar').offsetHeight") <= MAX_BAR_PX[size]
        assert page.page.evaluate("document.documentElement.scrollWidth") <= size[0]
        for test_id in ("stop", "state-pill", "link-pill"):
            box = page.box(test_id)
            assert 0 <= box["x"] <= box["x"] + box["width"] <= size[0]
            assert 0 <= box["y"] <= box["y"] + box["height"] <= size[1]
        page.open_panel("move")
        places = [(page.box("stop"), page.box("tab-move"))]
        page.part("close-panel-move").click()
        places.append((page.box("stop"), page.box("tab-move")))
        page.open_panel("move")
        # Slow, so that the arm still moves however late a test looks.
        page.part("speed").fill("0.05")
        page.part("named-extended").click()
        page.press("plan")
        page.press("go")
        page.until_offered("pause")
        assert page.page.evaluate(FIND_COVERED) == []
        page.stop()
        places.append((page.box("stop"), page.box("tab-move")))
        assert [place for place in places if place != places[0]] == []


def test_pads_stand_left_and_right_of_the_picture_with_a_bar_under_each_thumb(
    browser: Browser, server: RunningServer
) -> None:
    with opened(browser, LYING_PHONE, **TOUCH) as page:
        page.open(server.port)
        page.open_panel("drive")
        width, height = LYING_PHONE
        arm_x = page.screen_of((0.0, 0.0, 0.1))[0]
        for side, outer in (("left", 0), ("right", width)):
            pad, bar = page.box(f"pad-{side}"), page.box(f"dead-man-{side}")
            assert abs(pad["x"] + pad["width"] / 2 - outer) < width / 4
            assert bar["x"] == pytest.approx(pad["x"], abs=2)
            assert bar["y"] >= pad["y"] + pad["height"]
            assert bar["y"] + bar["height"] <= height
            assert (pad["x"] + pad["width"] < arm_x) == (side == "left")
        page.part("drive-rest").locator("> summary").click()
        assert page.part("jog-gripper-plus").is_visible()
