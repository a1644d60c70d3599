"""Driving the emulated arm by hand: buttons, keys, gamepad and pads; each moves it, and letting go stops it."""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import SPEED_FACTOR, publish, tip
from harness.page import PHONE, SHARED, Fingers, OpenPage, at_ready, opened
from harness.server import RunningServer
from tests.helpers.arm_record import MOVED_RAD, ArmRecord, hold_until

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

# Commands of the page, as they leave it, and how many had left it when an input was let go.
LISTEN = """
window.sent = [];
window.addEventListener("pointerdown", ({ pointerId }) => (window.pointer = pointerId), { capture: true });
for (const type of ["pointerup", "blur"]) {
    window.addEventListener(type, () => (window.let_go = window.sent.length), { capture: true });
}
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
    if (!window.stalled) send.call(this, data);
    const message = typeof data === "string" ? JSON.parse(data) : {};
    if (message.op === "publish" && message.topic.startsWith("/servo_node/delta")) {
        window.sent.push(message.msg);
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


def drive(record: ArmRecord, press: Callable[[], object], let_go: Callable[[], object]) -> None:
    """Press an input until the arm has moved."""
    began_s = time.time()
    hold_until(lambda: record.way_rad(began_s) > MOVED_RAD, press, let_go)


def last_is_zero(page: OpenPage) -> bool:
    return is_zero(page.page.evaluate("window.sent.at(-1)"))


def is_zero(msg: dict[str, Any]) -> bool:
    if "velocities" in msg:
        return not any(msg["velocities"])
    return not any(value for part in msg["twist"].values() for value in part.values())


def hold(page: OpenPage, test_id: str) -> None:
    page.part(test_id).scroll_into_view_if_needed()
    box = page.box(test_id)
    page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.mouse.down()


@pytest.mark.parametrize("test_id", ["jog-z-plus", "jog-shoulder_pan-plus"])
def test_a_button_moves_the_arm_while_it_is_held(page: OpenPage, record: ArmRecord, test_id: str) -> None:
    drive(record, lambda: hold(page, test_id), page.page.mouse.up)
    page.page.mouse.move(5, 300)
    page.page.mouse.up()
    assert last_is_zero(page)
    record.until_rest()


def commanded_rad(page: OpenPage, joint: str = "shoulder_pan") -> float:
    return float(page.state("commanded_rad")[joint])


def test_steps_move_a_joint_by_their_sizes_and_quick_presses_add_up(page: OpenPage, record: ArmRecord) -> None:
    page.part("drive-mode").select_option("1")
    end_rad = commanded_rad(page) - 3 * math.radians(5)
    for _ in range(3):
        page.part("jog-shoulder_pan-minus").click()
    page.until_state(f"Math.abs(s.commanded_rad.shoulder_pan - {end_rad}) < 1e-3")
    record.until_rest()
    assert commanded_rad(page) == pytest.approx(end_rad, abs=1e-3)
    assert page.joints()["shoulder_pan"] == pytest.approx(end_rad, abs=0.03)


def test_a_step_moves_the_tip_along_one_axis(page: OpenPage, record: ArmRecord, server: RunningServer) -> None:
    page.part("drive-mode").select_option("2")
    x_m, y_m, z_m = tip(server.url, "gripper_frame_link")
    lift_rad = commanded_rad(page, "shoulder_lift")
    page.part("jog-z-plus").click()
    page.until_state(f"s.pending_request === 'nothing' && Math.abs(s.commanded_rad.shoulder_lift - {lift_rad}) > 0.01")
    record.until_rest()
    # Servos carry the arm's weight, and have backlash.
    assert tip(server.url, "gripper_frame_link") == pytest.approx((x_m, y_m, z_m + 0.02), abs=0.006)


def test_a_stop_ends_steps_on_their_way(page: OpenPage, record: ArmRecord, server: RunningServer) -> None:
    page.part("drive-mode").select_option("2")
    end_rad = commanded_rad(page) - 6 * math.radians(15)
    # Slow, so that the steps are on their way however late the stop comes.
    publish(server.url, *SPEED_FACTOR, {"data": 0.1})
    for _ in range(6):
        page.part("jog-shoulder_pan-minus").click()
    page.until_state("s.goal.state === 'executing'")
    page.stop()
    record.until_rest()
    publish(server.url, *SPEED_FACTOR, {"data": 1.0})
    assert commanded_rad(page) > end_rad + 0.1


def test_keys_move_the_arm_once_they_are_switched_on_and_esc_stops_it(page: OpenPage, record: ArmRecord) -> None:
    page.part("tab-drive").evaluate("element => element.blur()")
    page.page.keyboard.down("Digit1")
    page.page.keyboard.up("Digit1")
    assert page.page.evaluate("window.sent.length") == 0
    page.part("jog").check()
    for key in ("Digit1", "ArrowDown"):
        drive(record, partial(page.page.keyboard.down, key), partial(page.page.keyboard.up, key))
        page.page.keyboard.up(key)
        assert last_is_zero(page)
        record.until_rest()
    drive(record, lambda: page.page.keyboard.down("KeyQ"), lambda: page.page.keyboard.up("KeyQ"))
    page.page.keyboard.press("Escape")
    assert last_is_zero(page)
    record.until_rest()
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
def test_who_leaves_lets_go(page: OpenPage, record: ArmRecord, leave: str) -> None:
    drive(record, lambda: hold(page, "jog-y-plus"), page.page.mouse.up)
    page.page.evaluate(leave)
    assert last_is_zero(page)
    record.until_rest()
    page.page.mouse.up()


def test_a_stalled_network_stops_the_arm(page: OpenPage, record: ArmRecord) -> None:
    drive(record, lambda: hold(page, "jog-shoulder_pan-minus"), page.page.mouse.up)
    page.page.evaluate("window.stalled = true")
    record.until_rest()
    page.page.mouse.up()
    page.page.evaluate("window.stalled = false")


def test_a_gamepad_moves_the_arm_while_its_dead_man_is_held(page: OpenPage, record: ArmRecord) -> None:
    page.part("gamepad").check()
    page.page.bring_to_front()
    page.page.evaluate("holdPad([1, 0, 0, 0], [])")
    page.until_text("gamepad-state", "test pad")
    assert page.page.evaluate("window.sent.length") == 0
    for let_go in ("holdPad([1, 0, 0, 0], [])", "window.pad = null"):
        page.page.evaluate("holdPad([1, 0, 0, 0], [])")
        page.until_text("gamepad-state", "hold a shoulder")
        let_pad_go = partial(page.page.evaluate, "holdPad([1, 0, 0, 0], [])")
        drive(record, partial(page.page.evaluate, "holdPad([1, 0, 0, 0], [4])"), let_pad_go)
        page.page.evaluate(let_go)
        record.until_rest()
    page.part("gamepad").uncheck()


def test_two_thumbs_drive_on_a_phone(phone: OpenPage, record: ArmRecord) -> None:
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

    drive(record, push_while_held, fingers.lift_all)
    fingers.lift(2)
    record.until_rest()
    fingers.lift(1)


def test_the_gripper_opens_while_its_button_is_held(page: OpenPage, record: ArmRecord) -> None:
    drive(record, lambda: hold(page, "jog-gripper-plus"), page.page.mouse.up)
    page.page.mouse.up()
    # To the end of the last goal of 0.2 s.
    record.until_rest(way_rad=0.6)
    # Nothing of the gripper is refused; on a busy machine the page says of other calls that no answer came in time.
    assert "gripper" not in [notice["key"] for notice in page.state("notices")]


def test_what_limits_the_arm_is_said_in_words(page: OpenPage, record: ArmRecord) -> None:
    page.part("tab-drive").evaluate("element => element.blur()")
    hold_until(lambda: page.state("servo_node.code") > 0, lambda: hold(page, "jog-x-plus"), page.page.mouse.up)
    page.until("/Slowed|Halted|limit/.test(document.querySelector('[data-testid=drive-status]').textContent)")
    page.page.mouse.up()
    # Close to a singularity joints are fast.
    record.until_rest(way_rad=1.0)
