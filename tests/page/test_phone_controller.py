"""A phone as a controller of the emulated arm: by its tilt and by WebXR."""

from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser

from harness.clients import tip
from harness.page import PHONE, SHARED, OpenPage, at_ready, opened
from harness.server import RunningServer
from tests.helpers.arm_record import ArmRecord, hold_until
from tests.page.test_drive import LISTEN, is_zero, last_is_zero

# The emulated servos' reading jitters by less.
MOVED_M = 0.01

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

# How the phone is held before it moves.
UPRIGHT = "Object.assign(phone, { beta: 40, gamma: 0, height_m: 0 })"

SETTINGS = SHARED


@pytest.fixture(scope="module")
def phone(browser: Browser) -> Iterator[OpenPage]:
    with opened(browser, PHONE, own=True, has_touch=True, is_mobile=True) as page:
        # A browser without windows has nobody to ask, and waits for an answer.
        page.page.context.grant_permissions(["accelerometer", "gyroscope", "magnetometer"])
        page.page.add_init_script(SENSORS + LISTEN)
        yield page


@pytest.fixture
def page(phone: OpenPage, record: ArmRecord, server: RunningServer) -> OpenPage:
    """The phone's page, opened again, with the arm in a pose from which it can be driven everywhere."""
    phone.open(server.port)
    phone.open_panel("drive")
    at_ready(phone, server.url)
    # The arm settles for a moment after its goal.
    record.until_rest()
    phone.page.evaluate(f"{UPRIGHT}; tracked = true; sent.length = 0")
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
    first = tip(server.url)[axis]
    ways_m = [0.0]

    def moved() -> bool:
        ways_m.append(tip(server.url)[axis] - first)
        return abs(ways_m[-1]) > MOVED_M

    def press() -> None:
        hold_clutch(page)
        move()

    def let_go() -> None:
        page.page.mouse.up()
        # A phone that comes back while the clutch is held takes the tip the other way.
        page.page.evaluate(f"clearInterval(window.falling); {UPRIGHT}")

    hold_until(moved, press, let_go)
    return ways_m[-1]


def assert_halted(page: OpenPage) -> None:
    """The last command is a halt, and no other command follows the release."""
    assert last_is_zero(page)
    page.pause(200)
    assert all(map(is_zero, page.page.evaluate("sent.slice(let_go)")))


def started_by_tilt(page: OpenPage) -> None:
    page.page.evaluate("window.sensors = true")
    page.part("phone-start").click()
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.started === 'true'")


def test_without_sensors_the_page_says_so(page: OpenPage) -> None:
    page.part("phone-start").click()
    page.until_text("phone-status", "gave no orientation within 2 s")
    assert page.part("phone-clutch").is_hidden()


def test_tilting_moves_the_tip_while_the_clutch_is_held(
    page: OpenPage, record: ArmRecord, server: RunningServer
) -> None:
    started_by_tilt(page)
    page.page.evaluate("phone.gamma = -30")
    page.pause(200)
    assert page.page.evaluate("sent.length") == 0, "nothing moves while the clutch is open"
    page.page.evaluate("phone.gamma = 0")
    page.pause(100)
    way_m = drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = -30"))
    assert way_m > 0, "to the left is +y"
    page.page.mouse.up()
    assert_halted(page)
    record.until_rest()


def test_sensors_that_fall_silent_stop_the_arm(page: OpenPage, record: ArmRecord, server: RunningServer) -> None:
    started_by_tilt(page)
    drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = 30"))
    page.page.evaluate("window.sensors = false")
    page.until("!Object.values(sent.at(-1).twist.linear).some(Boolean)")
    record.until_rest()
    page.page.mouse.up()


def test_who_looks_elsewhere_lets_go(page: OpenPage, record: ArmRecord, server: RunningServer) -> None:
    started_by_tilt(page)
    drive(page, server, 1, lambda: page.page.evaluate("phone.gamma = -30"))
    page.page.evaluate("window.dispatchEvent(new Event('blur'))")
    assert_halted(page)
    record.until_rest()
    page.page.mouse.up()


def test_tracked_by_webxr_the_tip_goes_the_way_of_the_phone(
    page: OpenPage, record: ArmRecord, server: RunningServer
) -> None:
    page.part("phone-track").click()
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.tracks === 'true'")
    assert page.page.evaluate("window.overlay === document.body"), "STOP stays in sight"
    page.part("phone-scale").fill("3")
    page.pause(100)
    fall = "window.falling = setInterval(() => { if (phone.height_m > -0.06) phone.height_m -= 0.001; }, 20)"
    way_m = drive(page, server, 2, lambda: page.page.evaluate(fall))
    assert way_m < 0, "the phone was lowered"
    page.page.evaluate("tracked = false")
    page.until("!Object.values(sent.at(-1).twist.linear).some(Boolean)")
    page.page.mouse.up()
    assert_halted(page)
    record.until_rest()
    page.page.evaluate("clearInterval(window.falling); session.end()")
    page.until("document.querySelector('[data-testid=phone-controller]').dataset.started === 'false'")


def test_a_server_for_this_machine_says_what_is_missing(page: OpenPage) -> None:
    page.part("phone-show-code").click()
    page.until_text("phone-note", "listens to this machine only")
    assert page.part("phone-qr").count() == 0
