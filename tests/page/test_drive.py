"""Driving the emulated arm by hand: buttons, keys, gamepad and pads; each moves it, and letting go stops it."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import tip
from harness.page import PHONE, SHARED, Fingers, OpenPage, at_ready, opened
from harness.server import RunningServer

# A servo's reading jitters by less; a jogged joint goes this way in a tenth of a second.
MOVED_RAD = 0.05
STILL_RAD_S = 0.02

# So often it is looked whether the arm stands, 0.3 s each: a gripper takes several seconds to open.
LOOKS = 4
MOVES_WITHIN_S = 120.0
PRESSED_MS = 15_000

# A gamepad with the standard mapping, which the tests hold in window.pad.
GAMEPAD = """
window.pad = null;
navigator.getGamepads = () => [window.pad];
window.holdPad = (axes, pressed) => {
    const button = (pressed) => ({ pressed, value: Number(pressed) });
    const buttons = Array.from({ length: 17 }, (_, i) => button(pressed.includes(i)));
    window.pad = { id: "test pad", index: 0, connected: true, mapping: "standard", axes, buttons };
};
"""

# Commands of the page, as they leave it.
LISTEN = """
window.sent = [];
window.addEventListener("pointerdown", ({ pointerId }) => (window.pointer = pointerId), { capture: true });
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
    if (!window.stalled) send.call(this, data);
    const message = typeof data === "string" ? JSON.parse(data) : {};
    if (message.op === "publish" && message.topic.startsWith("/servo_node/delta")) {
        window.sent.push({ at_ms: performance.now(), msg: message.msg });
    }
};
"""


SETTINGS = SHARED


@pytest.fixture(scope="module")
def desktop(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, own=True) as page:
        yield _opened_at_drive(page, server)


@pytest.fixture
def page(desktop: OpenPage, server: RunningServer) -> OpenPage:
    """The page with the arm in a pose from which it can be driven everywhere."""
    return _ready(desktop, server)


@pytest.fixture
def phone(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, PHONE, own=True, has_touch=True, is_mobile=True) as page:
        yield _ready(_opened_at_drive(page, server), server)


def _opened_at_drive(page: OpenPage, server: RunningServer) -> OpenPage:
    page.page.add_init_script(GAMEPAD + LISTEN)
    page.open(server.port)
    page.open_panel("drive")
    for name in ("drive-keys", "drive-gamepad"):
        page.page.locator(f"#section-{name} > summary").click()
    page.until("document.querySelectorAll('.jog-row').length > 5")
    return page


def _ready(page: OpenPage, server: RunningServer) -> OpenPage:
    at_ready(page, server.url)
    page.page.evaluate("window.stalled = false; window.pad = null; window.sent.length = 0")
    page.part("drive-mode").select_option("hold")
    return page


def drive(page: OpenPage, press: Callable[[], None], let_go: Callable[[], None]) -> None:
    """Press an input until the arm has moved."""
    first = list(page.joints().values())
    press_until(page, f"s.joints.position_rad.some((at, i) => Math.abs(at - {first}[i]) > {MOVED_RAD})", press, let_go)


def press_until(page: OpenPage, condition: str, press: Callable[[], None], let_go: Callable[[], None]) -> None:
    """Press an input until a condition of the state.

    A server that was late and has ended steering follows the held input again. After a link that was lost, and may be
    back by now, the input must be let go and pressed again.
    """
    until_s = time.monotonic() + MOVES_WITHIN_S
    while True:
        page.until_state("s.link.connected")
        press()
        with contextlib.suppress(AssertionError):
            return page.until_state(condition, PRESSED_MS)
        assert time.monotonic() < until_s, page.describe()
        let_go()


def until_still(page: OpenPage) -> None:
    """Wait until the arm stands and the servo loop has given it up."""
    # A state that is shown may be from before the motion: one that does not end is still seen after the last look.
    for _ in range(LOOKS):
        page.until_state(f"s.joints.velocity.every((speed) => Math.abs(speed) < {STILL_RAD_S})")
        at = list(page.joints().values())
        page.page.wait_for_timeout(300)
        if list(page.joints().values()) == pytest.approx(at, abs=0.02):
            return
    pytest.fail("the arm goes on moving")


def last_is_zero(page: OpenPage) -> bool:
    msg: dict[str, Any] = page.page.evaluate("window.sent.at(-1).msg")
    if "velocities" in msg:
        return not any(msg["velocities"])
    return not any(value for part in msg["twist"].values() for value in part.values())


def hold(page: OpenPage, test_id: str) -> None:
    page.part(test_id).scroll_into_view_if_needed()
    box = page.box(test_id)
    page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.mouse.down()


@pytest.mark.parametrize("test_id", ["jog-z-plus", "jog-shoulder_pan-plus"])
def test_a_button_moves_the_arm_while_it_is_held(page: OpenPage, test_id: str) -> None:
    drive(page, lambda: hold(page, test_id), page.page.mouse.up)
    page.page.mouse.move(5, 300)
    page.page.mouse.up()
    assert last_is_zero(page)
    until_still(page)


def commanded_rad(page: OpenPage, joint: str = "shoulder_pan") -> float:
    return float(page.state("commanded_rad")[joint])


def test_steps_move_a_joint_by_their_sizes_and_quick_presses_add_up(page: OpenPage) -> None:
    page.part("drive-mode").select_option("1")
    end_rad = commanded_rad(page) - 3 * math.radians(5)
    for _ in range(3):
        page.part("jog-shoulder_pan-minus").click()
    page.until_state(f"Math.abs(s.commanded_rad.shoulder_pan - {end_rad}) < 1e-3")
    until_still(page)
    assert commanded_rad(page) == pytest.approx(end_rad, abs=1e-3)
    assert page.joints()["shoulder_pan"] == pytest.approx(end_rad, abs=0.03)


def test_a_step_moves_the_tip_along_one_axis(page: OpenPage, server: RunningServer) -> None:
    page.part("drive-mode").select_option("2")
    x_m, y_m, z_m = tip(server.url, "gripper_frame_link")
    lift_rad = commanded_rad(page, "shoulder_lift")
    page.part("jog-z-plus").click()
    page.until_state(f"s.pending_request === 'nothing' && Math.abs(s.commanded_rad.shoulder_lift - {lift_rad}) > 0.01")
    until_still(page)
    # Servos carry the arm's weight, and have backlash.
    assert tip(server.url, "gripper_frame_link") == pytest.approx((x_m, y_m, z_m + 0.02), abs=0.006)


def test_a_stop_ends_steps_on_their_way(page: OpenPage) -> None:
    page.part("drive-mode").select_option("2")
    end_rad = commanded_rad(page) - 6 * math.radians(15)
    for _ in range(6):
        page.part("jog-shoulder_pan-minus").click()
    page.until_state("s.goal.state === 'executing'")
    page.part("stop").click()
    page.until_text("stop", "acknowledged")
    until_still(page)
    assert commanded_rad(page) > end_rad + 0.1


def test_keys_move_the_arm_once_they_are_switched_on_and_esc_stops_it(page: OpenPage) -> None:
    page.part("tab-drive").evaluate("element => element.blur()")
    page.page.keyboard.down("Digit1")
    page.page.keyboard.up("Digit1")
    assert page.page.evaluate("window.sent.length") == 0
    page.part("jog").check()
    for key in ("Digit1", "ArrowDown"):
        drive(page, partial(page.page.keyboard.down, key), partial(page.page.keyboard.up, key))
        page.page.keyboard.up(key)
        assert last_is_zero(page)
        until_still(page)
    drive(page, lambda: page.page.keyboard.down("KeyQ"), lambda: page.page.keyboard.up("KeyQ"))
    page.page.keyboard.press("Escape")
    assert last_is_zero(page)
    until_still(page)
    page.page.keyboard.up("KeyQ")
    page.part("jog").uncheck()


@pytest.mark.parametrize(
    "leave",
    [
        "window.dispatchEvent(new Event('blur'))",
        "document.dispatchEvent(new Event('visibilitychange'))",
        "document.querySelector('[data-held]')"
        ".dispatchEvent(new PointerEvent('lostpointercapture', { pointerId: window.pointer }))",
    ],
)
def test_who_leaves_lets_go(page: OpenPage, leave: str) -> None:
    drive(page, lambda: hold(page, "jog-y-plus"), page.page.mouse.up)
    page.page.evaluate(leave)
    assert last_is_zero(page)
    until_still(page)
    page.page.mouse.up()


def test_a_stalled_network_stops_the_arm(page: OpenPage) -> None:
    drive(page, lambda: hold(page, "jog-shoulder_pan-minus"), page.page.mouse.up)
    page.page.evaluate("window.stalled = true")
    until_still(page)
    page.page.mouse.up()
    page.page.evaluate("window.stalled = false")


def test_a_gamepad_moves_the_arm_while_its_dead_man_is_held(page: OpenPage) -> None:
    page.part("gamepad").check()
    page.page.bring_to_front()
    page.page.evaluate("holdPad([1, 0, 0, 0], [])")
    page.until_text("gamepad-state", "test pad")
    assert page.page.evaluate("window.sent.length") == 0
    for let_go in ("holdPad([1, 0, 0, 0], [])", "window.pad = null"):
        page.page.evaluate("holdPad([1, 0, 0, 0], [])")
        page.until_text("gamepad-state", "hold a shoulder")
        let_pad_go = partial(page.page.evaluate, "holdPad([1, 0, 0, 0], [])")
        drive(page, partial(page.page.evaluate, "holdPad([1, 0, 0, 0], [4])"), let_pad_go)
        page.page.evaluate(let_go)
        until_still(page)
    page.part("gamepad").uncheck()


def test_two_thumbs_drive_on_a_phone(phone: OpenPage) -> None:
    page = phone
    page.part("dead-man-left").scroll_into_view_if_needed()
    fingers = Fingers(page)

    def push_thumb() -> None:
        fingers.press(1, "pad-left")
        fingers.move(1, -60)

    push_thumb()
    assert page.page.evaluate("window.sent.length") == 0
    fingers.lift(1)

    def push_while_held() -> None:
        push_thumb()
        fingers.press(2, "dead-man-left")

    drive(page, push_while_held, fingers.lift_all)
    fingers.lift(2)
    until_still(page)
    fingers.lift(1)


def test_the_gripper_opens_while_its_button_is_held(page: OpenPage) -> None:
    drive(page, lambda: hold(page, "jog-gripper-plus"), page.page.mouse.up)
    page.page.mouse.up()
    until_still(page)
    assert page.state("notices") == []


def test_what_limits_the_arm_is_said_in_words(page: OpenPage) -> None:
    page.part("tab-drive").evaluate("element => element.blur()")
    press_until(page, "s.servo_node.code > 0", lambda: hold(page, "jog-x-plus"), page.page.mouse.up)
    page.until("/Slowed|Halted|limit/.test(document.querySelector('[data-testid=drive-status]').textContent)")
    page.page.mouse.up()
    until_still(page)
