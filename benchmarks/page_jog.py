"""Jog from the page: latency from a pressed key to the first changed goal of a servo, on the emulated bus."""

from __future__ import annotations

import contextlib
import tempfile
import time
from pathlib import Path

from harness.clients import goal
from harness.emulator import RunningEmulator
from harness.figures import percentiles, print_table
from harness.page import OpenPage, chromium, opened, what_is_missing
from harness.server import RunningServer
from harness.write_log import Entry, read_entries

STROKES = 20
STROKE_MS, PAUSE_MS = 400, 1200

# Keys of the page that turn one joint and move the tip to the side, to and fro.
KEYS = {"joint": ("Digit1", "KeyQ"), "tip": ("ArrowLeft", "ArrowRight")}

# The time of the browser's own event, by the clock of the machine that page and server share [ms].
LISTEN = """() => window.addEventListener("keydown", (event) => {
    window.pressed_ms = performance.timeOrigin + event.timeStamp;
}, { capture: true })"""


def run() -> None:
    """Measure with one server and one browser, or print the reason why that is impossible."""
    missing = what_is_missing()
    if missing:
        print(f"\nThe page cannot be measured: {missing}")
        return
    rows = []
    with contextlib.ExitStack() as stack:
        log = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "writes.jsonl"
        emulator = RunningEmulator("--write-log", str(log))
        stack.callback(emulator.end)
        settings = {"ARMBRIDGE_ACCESS__CONTROL": "shared"}
        server = stack.enter_context(
            RunningServer(f"--port 0 --serial {emulator.port} --calibration nominal", settings=settings)
        )
        page = stack.enter_context(opened(stack.enter_context(chromium()), draws=True))
        page.open(server.port)
        page.until_state("s.arm.mode === 'holding'")
        goal(server.url, "/moveit_goal_named", {"data": "ready"})
        page.page.evaluate(LISTEN)
        page.open_panel("drive")
        page.page.locator("#section-drive-keys > summary").click()
        page.part("jog").check()
        for name, keys in KEYS.items():
            pressed_s = [_stroke(page, keys[stroke % 2]) for stroke in range(STROKES)]
            late_s = _latencies_s(read_entries(log), pressed_s)
            rows.append([name, f"{len(late_s)} of {STROKES}", *percentiles(late_s, 50, 90, 100)])
    print_table(
        "From a pressed key of the page to the first changed goal of a servo [ms]",
        ["key of", "strokes", "p50", "p90", "max"],
        rows,
    )


def _stroke(page: OpenPage, key: str) -> float:
    """Hold a key and release it; returns the time at which it was pressed (monotonic [s])."""
    page.page.keyboard.down(key)
    page.page.wait_for_timeout(STROKE_MS)
    page.page.keyboard.up(key)
    page.page.wait_for_timeout(PAUSE_MS)
    return float(page.page.evaluate("window.pressed_ms")) / 1e3 - (time.time() - time.monotonic())


def _latencies_s(entries: list[Entry], pressed_s: list[float]) -> list[float]:
    """Return the time from each press to the first goal that differs from the one at the press [s]."""
    late_s = []
    for at_s in pressed_s:
        before = next(entry for entry in reversed(entries) if entry.at_s <= at_s)
        stroke = [entry for entry in entries if at_s < entry.at_s < at_s + STROKE_MS / 1e3]
        late_s += [entry.at_s - at_s for entry in stroke if entry.goal != before.goal][:1]
    return late_s
