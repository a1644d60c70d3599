"""A phone as a controller of the emulated arm: by its tilt and by WebXR."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import tip
from harness.page import PHONE, SHARED, OpenPage, at_ready, opened
from harness.server import RunningServer

# The emulated servos' reading jitters by less.
MOVED_M = 0.01
STILL_RAD_S = 0.02
MOVES_WITHIN_S = 180.0

# A phone whose pose the tests hold in window.phone: its sensors tell it all the time, or WebXR once a frame.
SENSORS = """
window.phone = { beta: 40, gamma: 0, height_m: 0 };
window.sensors = false;
setInterval(() => {
    if (!window.sensors) return;
    const { beta, gamma } = window.phone;
    window.dispatchEvent(new DeviceOrientationEvent("deviceorientation", { alpha: 0, beta, gamma }));
}, 15);

class FakeSession extends EventTarget {
    domOverlayState = { type: "screen" };
    ended = false;
    requestAnimationFrame(callback) {
        setTimeout(() => {
            if (this.ended) return;
            const transform = {
                position: { x: 0, y: window.phone.height_m, z: 0 },
                orientation: { x: 0, y: 0, z: 0, w: 1 },
            };
            const pose = window.tracked ? { transform, emulatedPosition: false } : null;
            callback(performance.now(), { getViewerPose: () => pose });
        }, 15);
    }
    requestReferenceSpace() { return Promise.resolve({}); }
    updateRenderState() { return Promise.resolve(); }
    end() {
        this.ended = true;
        this.dispatchEvent(new Event("end"));
        return Promise.resolve();
    }
}
window.tracked = true;
window.XRWebGLLayer = class {};
Object.defineProperty(navigator, "xr", { value: {
    isSessionSupported: () => Promise.resolve(true),
    requestSession: (_mode, options) => {
        window.overlay = options.domOverlay.root;
        return Promise.resolve(window.session = new FakeSession());
    },
} });
"""

# Commands of the page, as they leave it.
LISTEN = """
window.sent = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
    send.call(this, data);
    const message = typeof data === "string" ? JSON.parse(data) : {};
    if (message.op === "publish" && message.topic === "/servo_node/delta_twist_cmds") {
        window.sent.push({ at_ms: performance.now(), twist: message.msg.twist });
    }
};
for (const type of ["pointerup", "blur"]) {
    window.addEventListener(type, () => (window.let_go_ms = performance.now()), { capture: true });
}
"""


SETTINGS = SHARED


@pytest.fixture(scope="module")
def phone(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    with opened(browser, PHONE, own=True, has_touch=True, is_mobile=True) as page:
        page.page.add_init_script(SENSORS + LISTEN)
        page.open(server.port)
        page.open_panel("drive")
        yield page


@pytest.fixture
def page(phone: OpenPage, server: RunningServer) -> OpenPage:
    """The phone's page with the arm in a pose from which it can be driven everywhere."""
    at_ready(phone, server.url)
    phone.page.evaluate("Object.assign(phone, { beta: 40, gamma: 0, height_m: 0 }); tracked = true; sent.length = 0")
    return phone


def hold_clutch(page: OpenPage) -> None:
    clutch = page.part("phone-clutch")
    clutch.scroll_into_view_if_needed()
    box = page.box("phone-clutch")
    assert box["height"] >= 100, "the thumb finds it without a look"
    page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.page.mouse.down()
    page.until("document.querySelector('[data-testid=phone-clutch]').dataset.held === 'true'")


def drive(page: OpenPage, server: RunningServer, axis: int, move: Callable[[], None]) -> float:
    """Hold the clutch and move the phone until the tip has moved on the server's side; return its way [m]."""
    # The arm settles for a moment after its goal.
    until_still(page, server)
    first = tip(server.url)[axis]
    until_s = time.monotonic() + MOVES_WITHIN_S
    while True:
        hold_clutch(page)
        move()
        # A page that stood still for 0.08 s has begun the grip again, from the tilt that the phone has by then.
        for _ in range(20):
            page.page.wait_for_timeout(50)
            if abs(way := tip(server.url)[axis] - first) > MOVED_M:
                return way
        assert time.monotonic() < until_s, page.describe()
        page.page.mouse.up()
        # A phone that comes back while the clutch is held takes the tip the other way.
        page.page.evaluate("clearInterval(window.falling); Object.assign(phone, { beta: 40, gamma: 0, height_m: 0 })")
        page.page.wait_for_timeout(400)


def until_still(page: OpenPage, server: RunningServer) -> None:
    page.until_state(f"s.joints.velocity.every((speed) => Math.abs(speed) < {STILL_RAD_S})")
    at = tip(server.url)
    page.page.wait_for_timeout(300)
    assert tip(server.url) == pytest.approx(at, abs=0.003), "the arm goes on moving"


def assert_halted(page: OpenPage) -> None:
    """The last command is a halt, sent within 100 ms of the release, and none follows."""
    last: dict[str, Any] = page.page.evaluate("window.sent.at(-1)")
    assert not any(value for part in last["twist"].values() for value in part.values())
    assert last["at_ms"] - page.page.evaluate("window.let_go_ms") < 100.0
    page.page.wait_for_timeout(200)
    assert page.page.evaluate("window.sent.at(-1).at_ms") == last["at_ms"]


def started_by_tilt(page: OpenPage) -> None:
    page.page.evaluate("window.sensors = true")
    page.part("phone-start").click()
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.started === 'true'")


def test_without_sensors_the_page_says_so(page: OpenPage) -> None:
    page.page.evaluate("window.sensors = false")
    page.part("phone-start").click()
    page.until_text("phone-status", "gave no orientation within 2 s")
    assert page.part("phone-clutch").is_hidden()


def test_tilting_moves_the_tip_while_the_clutch_is_held(page: OpenPage, server: RunningServer) -> None:
    started_by_tilt(page)
    page.page.evaluate("phone.gamma = -30")
    page.page.wait_for_timeout(200)
    assert page.page.evaluate("sent.length") == 0, "nothing moves while the clutch is open"
    page.page.evaluate("phone.gamma = 0")
    page.page.wait_for_timeout(100)
    way_m = drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = -30"))
    assert way_m > 0, "to the left is +y"
    page.page.mouse.up()
    assert_halted(page)
    until_still(page, server)


def test_sensors_that_fall_silent_stop_the_arm(page: OpenPage, server: RunningServer) -> None:
    started_by_tilt(page)
    drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = 30"))
    page.page.evaluate("window.sensors = false")
    page.until("!Object.values(sent.at(-1).twist.linear).some(Boolean)")
    until_still(page, server)
    page.page.mouse.up()


def test_who_looks_elsewhere_lets_go(page: OpenPage, server: RunningServer) -> None:
    started_by_tilt(page)
    drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = -30"))
    page.page.evaluate("window.dispatchEvent(new Event('blur'))")
    assert_halted(page)
    until_still(page, server)
    page.page.mouse.up()


def test_tracked_by_webxr_the_tip_goes_the_way_of_the_phone(page: OpenPage, server: RunningServer) -> None:
    page.part("phone-track").click()
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.tracks === 'true'")
    assert page.page.evaluate("window.overlay === document.body"), "STOP stays in sight"
    page.part("phone-scale").fill("3")
    page.page.wait_for_timeout(100)
    fall = "window.falling = setInterval(() => { if (phone.height_m > -0.06) phone.height_m -= 0.001; }, 20)"
    way_m = drive(page, server, 2, lambda: page.page.evaluate(fall))
    assert way_m < 0, "the phone was lowered"
    page.page.evaluate("tracked = false")
    page.until("!Object.values(sent.at(-1).twist.linear).some(Boolean)")
    page.page.mouse.up()
    assert_halted(page)
    until_still(page, server)
    page.page.evaluate("clearInterval(window.falling); session.end()")
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.started === 'false'")


def test_a_server_for_this_machine_says_what_is_missing(page: OpenPage) -> None:
    page.part("phone-show-code").click()
    page.until_text("phone-note", "listens to this machine only")
    assert page.part("phone-qr").count() == 0
