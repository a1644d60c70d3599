"""The page in Debian's Chromium: started, looked at and steered by Playwright."""

import hashlib
import io
import json
import os
import re
import shlex
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, Locator, Page, WebSocketRoute, sync_playwright

from harness.clients import call, goal
from harness.server import ROOT
from harness.waiting import TIMEOUT_S

BUILT = ROOT / "server" / "page" / "dist" / "index.html"
SHOTS = ROOT / "build" / "page"

# The one without windows comes first: a context takes 0.14 s of processor time in place of 0.47 s, a test a fifth less.
BROWSERS = ("chromium-headless-shell", "chromium")

# As on a machine without a graphics card: the processor alone composes the page and draws WebGL. Nothing calls home.
FLAGS = (
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
)

# All that WebGL draws, which costs more than the rest of the page where the processor draws it. Frames are prepared
# and counted as ever.
DRAW_NOTHING = """
for (const name of ["clear", "drawArrays", "drawElements"]) WebGL2RenderingContext.prototype[name] = () => undefined;
"""

PANELS = ("move", "drive", "sequence", "world", "plots", "goals", "arm", "cameras", "recording", "log", "settings")

DESKTOP = (1280, 800)
PHONE = (390, 844)
LYING_PHONE = (844, 390)
# Sizes of the window at which nothing may be cut off.
SIZES = [(1440, 900), (1024, 768), (820, 1180), PHONE, LYING_PHONE]

# Software rendering on two shared cores: what takes 0.1 s on a quiet machine takes minutes beside fifty other programs.
PATIENCE_MS = 1e3 * TIMEOUT_S

# How often the page looks whether something is so, and how often a test asks.
LOOK_MS, ASK_MS = 20, 50

UNTIL = """(async () => {
    const end = performance.now() + %s;
    while (!(%s)) {
        if (performance.now() > end) return false;
        await new Promise(done => setTimeout(done, %s));
    }
    return true;
})()"""

# Page and tests drive in turns, without waiting for each other.
SHARED = {"ARMBRIDGE_ACCESS__CONTROL": "shared"}

AXE = ROOT / "server" / "page" / "node_modules" / "axe-core" / "axe.min.js"

# WCAG's levels A and AA of each version, and axe-core's own good practice.
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]

FIND_VIOLATIONS = """async ([within, rules]) => {
    const { violations } = await window.axe.run(within, {
        runOnly: { type: "tag", values: rules }, resultTypes: ["violations"],
    });
    return violations.flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) => {
        return `${id}: ${target.join(" ")}: ${failureSummary.replace(/\\s+/g, " ")}`;
    }));
}"""


def page_digest() -> str:
    """Digest of the sources that decide how the page looks and what it does, without their tests."""
    sources = [ROOT / "server" / "page" / "index.html", *(ROOT / "server" / "page" / "src").rglob("*")]
    digest = hashlib.sha256()
    for path in sorted(path for path in sources if path.is_file() and not path.name.endswith(".test.ts")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _browser() -> str | None:
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def browser_is_missing() -> str:
    """Return the reason for having no browser here; empty when one can be started."""
    return "" if _browser() else f"no browser is installed (apt-get install {BROWSERS[0]})"


def what_is_missing() -> str:
    """Return the reason for having no page here; empty when it can be opened."""
    if reason := browser_is_missing():
        return reason
    if not BUILT.exists():
        return f"{BUILT.relative_to(ROOT)} is not built (make page)"
    return ""


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser that ends with the block."""
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=_modest(Path(folder)), args=list(FLAGS))
        try:
            yield browser
        finally:
            _LEFT.clear()
            browser.close()


def _modest(folder: Path) -> str:
    """The browser at a low priority, without root's right to raise its own, which it uses.

    Software rendering otherwise keeps the server and the arm's loop from the cores. At the idle priority (SCHED_IDLE) a
    browser beside a load of 25 read nothing for seconds, and left a server that had answered.
    """
    found = _browser()
    assert found is not None
    words = ["nice", "-n", "10", found]
    if os.geteuid() == 0 and shutil.which("setpriv"):
        words = ["setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice", *words]
    script = folder / "chromium"
    script.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    script.chmod(0o755)
    return str(script)


@dataclass
class OpenPage:
    """One opened page, and what went wrong in it."""

    page: Page
    errors: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda message: self._heard(message.type, message.text))
        self.page.on("request", lambda request: self.hosts.add(request.url.split("/")[2]))

    def _heard(self, kind: str, text: str) -> None:
        # A server that is away is no error of the page; the browser logs every attempt all the same.
        if kind == "error" and "WebSocket connection" not in text:
            self.errors.append(text)

    def open(self, port: int, rest: str = "") -> None:
        """Open the page of a server and wait until the arm is drawn."""
        self.goto(port, rest)
        self.until("window.armbridge?.drawn.arm_ms > 0")

    def leave(self) -> None:
        """Leave the server; the next page begins as new, but with the scripts and meshes that the browser has."""
        origin = self.page.evaluate("location.origin")
        if origin != "null":
            # Here as well: what a page of a busy browser has stored last may reach the disk after the session's order.
            self.page.evaluate("localStorage.clear(); sessionStorage.clear()")
        self.page.goto("about:blank")
        if origin != "null":
            session = self.page.context.new_cdp_session(self.page)
            session.send("Storage.clearDataForOrigin", {"origin": origin, "storageTypes": "local_storage"})
            session.detach()
        # As a test that failed may have left it.
        self.page.mouse.up()
        self.page.mouse.move(0, 0)
        self.errors.clear()
        self.hosts.clear()

    def goto(self, port: int, rest: str = "") -> None:
        """Open the page of a server, with the rest of its address."""
        self.page.goto(f"http://127.0.0.1:{port}/{rest}")

    def until(self, condition: str, timeout_ms: float = PATIENCE_MS) -> None:
        """Wait until an expression in the page is true.

        The page looks by itself, which costs a tenth of asking it again and again. Playwright's own way of waiting
        evaluates texts in the page, which the page's Content-Security-Policy forbids.
        """
        met = self.page.evaluate(UNTIL % (timeout_ms, condition, LOOK_MS))
        assert met, f"{condition} within {timeout_ms} ms: {self.describe()}"

    def wait(self, condition: Callable[[], object]) -> None:
        """Wait until something is so that is asked from here, while the page goes on."""
        until_s = time.monotonic() + PATIENCE_MS / 1e3
        while not condition():
            assert time.monotonic() < until_s, self.describe()
            self.page.wait_for_timeout(ASK_MS)

    def pause(self, duration_ms: float) -> None:
        """Let time pass in the page, with all that its timers have to do by then."""
        self.page.evaluate("ms => new Promise(done => setTimeout(done, ms))", duration_ms)

    def describe(self) -> str:
        """Return the visible text, for the message of a failed test."""
        said = {
            test_id: self.page.get_by_test_id(test_id).text_content()
            for test_id in ("state-pill", "link-pill", "message", "control", "stop", "target-state", "notices")
            if self.page.get_by_test_id(test_id).count()
        }
        return f"{said}; errors: {self.errors}"

    def until_state(self, condition: str, timeout_ms: float = PATIENCE_MS) -> None:
        """Wait until an expression over the page's state, ``s``, is true."""
        self.until(f"(() => {{ const s = window.armbridge.state(); return {condition}; }})()", timeout_ms)

    def state(self, path: str) -> Any:
        """A part of the page's state, as in ``arm.mode``."""
        return self.page.evaluate(f"window.armbridge.state().{path}")

    def open_panel(self, panel: str, *sections: str) -> None:
        """Open a panel by its button on the rail, or in the rail's menu, and open sections of it."""
        tab = self.part(f"tab-{panel}")
        if not self.part(f"panel-{panel}").is_visible():
            if not tab.is_visible():
                self.part("more-panels").click()
            tab.click()
        self.part(f"panel-{panel}").wait_for()
        for section in sections:
            details = self.part(f"section-{section}")
            if not details.evaluate("details => details.open"):
                details.locator("summary").click()

    def open_panels(self) -> Iterator[str]:
        """Show one panel after the other, each with all its sections open."""
        for panel in PANELS:
            shown = f"document.querySelector('#panel-{panel}')?.checkVisibility()"
            # At once: a click waits for frames, and that the rail is clicked is seen wherever a test opens one panel.
            self.page.evaluate(f"{shown} || document.querySelector('#tab-{panel}').click()")
            self.until(shown)
            self.page.evaluate(f"document.querySelectorAll('#panel-{panel} details').forEach(each => each.open = true)")
            yield panel

    def part(self, test_id: str) -> Locator:
        """The element of that ``data-testid``."""
        return self.page.get_by_test_id(test_id)

    def until_offered(self, action: str) -> Locator:
        """Wait until the primary button offers an action, which is plan, go, pause or resume; returns the button."""
        primary = self.page.locator(f"[data-testid=primary][data-action={action}]:enabled")
        primary.wait_for()
        return primary

    def press(self, action: str) -> None:
        """Press the primary button once it offers an action."""
        self.until_offered(action).click()

    def offers(self, action: str) -> bool:
        """Whether the primary button offers an action now."""
        return self.page.locator(f"[data-testid=primary][data-action={action}]:enabled").count() > 0

    def box(self, test_id: str) -> dict[str, float]:
        """Where an element is on the screen: x, y, width and height [px]."""
        self.part(test_id).wait_for()
        box = self.part(test_id).bounding_box()
        assert box is not None, f"{test_id} is not shown"
        return dict(box)

    def stop(self) -> None:
        """Press STOP, and wait for its acknowledgement."""
        self.part("stop").click()
        self.until_acknowledged()

    def until_acknowledged(self) -> None:
        """Wait for the answer to a press of STOP. Its text goes after four seconds, and a test may look later."""
        self.until_state("s.stop.phase !== 'asked'")
        assert self.state("stop.phase") != "failed", self.describe()

    def enter(self, test_id: str, text: str) -> None:
        """Type into a field, and press Enter."""
        self.part(test_id).fill(text)
        self.part(test_id).press("Enter")

    def download(self, test_id: str, folder: Path) -> Path:
        """Press a button that saves a file; returns the file."""
        with self.page.expect_download() as download:
            self.part(test_id).click()
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def joints(self) -> dict[str, float]:
        """The joint positions that the page has [rad]."""
        joints = self.state("joints")
        return dict(zip(joints["names"], joints["position_rad"], strict=True))

    def until_text(self, test_id: str, text: str, timeout_ms: float = PATIENCE_MS) -> None:
        """Wait until an element says something."""
        element = f"document.querySelector({json.dumps(f'[data-testid={json.dumps(test_id)}]')})"
        self.until(f"!!{element}?.textContent.includes({json.dumps(text)})", timeout_ms)

    def shot(self, name: str) -> Path:
        """Keep a screenshot as an artefact."""
        SHOTS.mkdir(parents=True, exist_ok=True)
        path = SHOTS / f"{name}.png"
        self.page.screenshot(path=path)
        return path

    def colours(self) -> int:
        """Number of colours of the drawing: a blank canvas has one."""
        image = Image.open(io.BytesIO(self.page.locator("canvas").first.screenshot())).convert("RGB").resize((64, 64))
        return len(image.getcolors(64 * 64) or [])

    def violations(self, within: str = "html") -> list[str]:
        """Return what axe-core finds wrong in what is shown within elements of a selector."""
        if not self.page.evaluate("'axe' in window"):
            self.page.evaluate(AXE.read_text())
        found: list[str] = self.page.evaluate(FIND_VIOLATIONS, [within, RULES])
        return found

    def change_operations(self, change: Callable[[dict[str, Any]], dict[str, Any] | None]) -> None:
        """Have every operation of the server changed, or swallowed, on its way to the page."""

        def pass_on(route: WebSocketRoute, frame: str | bytes) -> None:
            changed = change(json.loads(frame))
            if changed is not None:
                route.send(json.dumps(changed))

        def connected(route: WebSocketRoute) -> None:
            route.connect_to_server().on_message(lambda frame: pass_on(route, frame))

        self.page.route_web_socket(re.compile("^ws://"), connected)

    def until_colour(self, position_m: tuple[float, float, float], wanted: Callable[[int, int, int], bool]) -> None:
        """Wait until what is drawn over a point of the root link's frame has a colour (0 to 255)."""
        self.wait(lambda: wanted(*self._colour_at(position_m)))

    def _colour_at(self, position_m: tuple[float, float, float]) -> tuple[int, int, int]:
        x, y = self.screen_of(position_m)
        picture = self.page.screenshot(clip={"x": x, "y": y, "width": 1, "height": 1})
        red, green, blue = Image.open(io.BytesIO(picture)).convert("RGB").tobytes()[:3]
        return red, green, blue

    def screen_of(self, position_m: tuple[float, float, float]) -> tuple[float, float]:
        """Return the place of a point of the root link's frame on the screen, as it is drawn now [px]."""
        # What changed is in the next frame, and can be grabbed from then on.
        self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        x, y = self.page.evaluate("p => window.armbridge.screen_of(...p)", list(position_m))
        return float(x), float(y)


class Fingers:
    """Fingers on the screen of a phone; each stays until it is lifted."""

    def __init__(self, page: OpenPage) -> None:
        self._page = page
        self._touches = page.page.context.new_cdp_session(page.page)
        self._down: dict[int, dict[str, Any]] = {}

    def press(self, finger: int, test_id: str) -> None:
        """Put a finger onto the middle of an element."""
        box = self._page.box(test_id)
        self._down[finger] = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "id": finger}
        self._send("touchStart", *self._down.values())

    def move(self, finger: int, right_px: float) -> None:
        """Move a finger to the right."""
        self._down[finger] = {**self._down[finger], "x": self._down[finger]["x"] + right_px}
        self._send("touchMove", *self._down.values())

    def lift(self, finger: int) -> None:
        """Lift a finger, if it is down."""
        if finger in self._down:
            self._send("touchEnd", self._down.pop(finger))

    def lift_all(self) -> None:
        """Lift all fingers."""
        for finger in list(self._down):
            self.lift(finger)

    def _send(self, kind: str, *points: dict[str, Any]) -> None:
        self._touches.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def at_ready(page: OpenPage, url: str) -> None:
    """Have the arm stand in the pose ready, from which it can be driven everywhere, whatever became of it before."""
    if page.state("arm.mode") == "fault":
        call(url, "/arm/reset_fault")
        page.until_state("s.arm.mode === 'holding'")
    assert goal(url, "/moveit_goal_named", {"data": "ready"})["val"] == 1


# Pages that were left, by what cannot be changed in an open one.
_LEFT: dict[str, list[OpenPage]] = {}


@contextmanager
def opened(
    browser: Browser,
    size: tuple[int, int] = DESKTOP,
    *,
    draws: bool = False,
    own: bool = False,
    color_scheme: Any = "light",
    **options: Any,
) -> Iterator[OpenPage]:
    """A page as new. Where a page of its kind was left it is that one, which opens with a third of the CPU.

    Args:
        draws: for tests that look at the picture of the arm, which is empty without it.
        own: in a context of its own, to put scripts and routes into, which cannot be taken out; closed at the end.
    """
    left = [] if own else _LEFT.setdefault(f"{draws} {options}", [])
    page = left.pop() if left else _new_page(browser, draws, options)
    try:
        page.page.set_viewport_size({"width": size[0], "height": size[1]})
        page.page.emulate_media(color_scheme=color_scheme)
        yield page
        if not own:
            page.leave()
            left.append(page)
    finally:
        if page not in left:
            page.page.context.close()


def _new_page(browser: Browser, draws: bool, options: dict[str, Any]) -> OpenPage:
    context = browser.new_context(**options)
    if not draws:
        context.add_init_script(DRAW_NOTHING)
    return OpenPage(context.new_page())
