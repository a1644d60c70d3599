"""Page in Chromium with software rendering: size, load time, frame rate, age of the drawn states, cost to the server.

``python -m benchmarks.page --seconds 600`` watches the moving arm for ten minutes; ``--only size`` measures one part.
"""

from __future__ import annotations

import argparse
import functools
import gzip
import json
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import psutil
from websockets.sync.client import connect

from harness.clients import call
from harness.figures import percentiles, print_table
from harness.page import BUILT, chromium, opened, what_is_missing
from harness.server import RunningServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser

OPENINGS = 5
WATCHED_S = 20.0

LOOKED_AT_S = 10.0  # the age is measured over this time at the end of the period, where a growing lag is greatest
TURNS = 3
CPU_S = 10.0  # long enough that one goal, or one question of the page, does not count

# The planner workers load their libraries behind the start, and the page its own behind the first drawing.
WARM_UP_S = 4.0

SUCCESS = 1

# What each figure is to be: sizes on the wire, the first picture, the frames, and the cost beside a plain subscriber.
MAX_SCRIPT_BYTES = 1_500_000
MAX_GZIP_BYTES = 450_000
MAX_READY_S = 1.0
MIN_FRAMES_PER_S = 30.0
MAX_AGE_FRAMES = 1.0  # not reached: the page takes 30 of 50 states a second, and each waits up to 20 ms for its turn
MAX_COST_RATIO = 1.5

PARTS = ("size", "ready", "watched", "costs")

JOINT_STATES = "/joint_states"

# Quantities that are plotted beside the page's first chart, a chart each.
MORE_QUANTITIES = ("error", "velocity", "load")

# After every frame of the browser: whether the page drew in it, and how old the joint state was that it drew, by the
# clock of the machine that server and browser share. A part of it has passed since the state's arrival at the page.
WATCH = """() => {
    window.watched = { ages_s: [], waits_s: [], since_ms: performance.now(), frames: window.armbridge.drawn.frames };
    let frames = window.watched.frames;
    const look = () => {
        const drawn = window.armbridge.drawn;
        if (drawn.frames !== frames) {
            window.watched.ages_s.push(Date.now() / 1000 - drawn.joint_stamp_s);
            window.watched.waits_s.push(drawn.age_ms / 1000);
        }
        frames = drawn.frames;
    };
    const next = () => {
        setTimeout(look, 0);
        requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
}"""
WATCHED = """() => ({
    ages_s: window.watched.ages_s,
    waits_s: window.watched.waits_s,
    drawn: window.armbridge.drawn.frames - window.watched.frames,
    seconds: (performance.now() - window.watched.since_ms) / 1000,
})"""


@dataclass(frozen=True)
class Watched:
    """Frames and states drawn in a period, and the part of the states' ages that has passed since their arrival."""

    frames_per_s: float
    cpu_ms: float  # of all the browser's processes, for each frame
    ages_s: list[float]
    waits_s: list[float]

    def in_frames(self) -> list[float]:
        """Return the ages in frames of the mean length."""
        return [age_s * self.frames_per_s for age_s in self.ages_s]


def run(seconds: float = WATCHED_S, parts: Sequence[str] = PARTS) -> None:
    """Measure with one server and one browser, or print the reason why that is impossible."""
    missing = what_is_missing()
    if missing:
        print(f"\nThe page cannot be measured: {missing}")
        return
    if "size" in parts:
        _print_sizes()
    if not {"ready", "watched", "costs"}.intersection(parts):
        return
    with RunningServer() as server, chromium() as browser:
        time.sleep(WARM_UP_S)
        if "ready" in parts:
            _print_ready([_ready_s(browser, server) for _ in range(OPENINGS)])
        if "watched" in parts:
            turns = [1, 1 + len(MORE_QUANTITIES)] * TURNS
            _print_watched([(charts, _watched(browser, server, charts, seconds)) for charts in turns], seconds)
        if "costs" in parts:
            _print_costs(_costs(browser, server), "at rest")
            with _moving(server):
                _print_costs(_costs(browser, server), "in motion")


def _print_sizes() -> None:
    scripts = [path.read_bytes() for path in sorted(BUILT.parent.rglob("*.js"))]
    raw, packed = (sum(map(len, files)) for files in (scripts, [gzip.compress(script, 9) for script in scripts]))
    print_table(
        "Size of the page's scripts",
        ["", "kB", "limit [kB]", "of the limit"],
        [
            [name, f"{size / 1e3:.0f}", f"{limit / 1e3:.0f}", f"{size / limit:.2f}"]
            for name, size, limit in (("raw", raw, MAX_SCRIPT_BYTES), ("gzip", packed, MAX_GZIP_BYTES))
        ],
    )


def _print_ready(ready_s: list[float]) -> None:
    print_table(
        f"The page from its request to the drawn arm [s], to be {MAX_READY_S:g}",
        ["openings", "median", "max"],
        [[str(OPENINGS), *percentiles(ready_s, 50, 100, scale=1.0)]],
    )


def _print_watched(turns: list[tuple[int, Watched]], seconds: float) -> None:
    print_table(
        f"A moving arm and its plots on the page, in turns, at the end of {seconds:.0f} s, to be {MIN_FRAMES_PER_S:g}"
        f" frames/s and {MAX_AGE_FRAMES:g} frame old",
        [
            "charts",
            "frames/s",
            "CPU [ms/frame]",
            "age of the state p50 [ms]",
            "p99",
            "on the page",
            "in frames p50",
            "p99",
            "max",
        ],
        [
            [
                str(charts),
                f"{watched.frames_per_s:.1f}",
                f"{watched.cpu_ms:.1f}",
                *percentiles(watched.ages_s, 50, 99, digits=1),
                *percentiles(watched.waits_s, 50, digits=1),
                *percentiles(watched.in_frames(), 50, 99, 100, scale=1.0),
            ]
            for charts, watched in turns
        ],
    )


def _print_costs(costs_percent: dict[str, list[float]], arm: str) -> None:
    medians = {name: statistics.median(percents) for name, percents in costs_percent.items()}
    print_table(
        f"What the server's process spends, the arm {arm}, medians, to be {MAX_COST_RATIO:g} times the subscriber",
        ["for", "CPU % of a core", "beyond nobody", "of the subscriber's"],
        [
            [name, f"{percent:.2f}", f"{percent - medians['nobody']:.2f}", f"{percent / medians[JOINT_STATES]:.2f}"]
            for name, percent in medians.items()
        ],
    )


def _ready_s(browser: Browser, server: RunningServer) -> float:
    with opened(browser, draws=True, own=True) as page:
        page.open(server.port)
        return float(page.page.evaluate("window.armbridge.drawn.arm_ms")) / 1e3


def _watched(browser: Browser, server: RunningServer, charts: int, seconds: float) -> Watched:
    with opened(browser, draws=True) as page, _moving(server):
        page.open(server.port)
        page.open_panel("plots")
        for quantity in MORE_QUANTITIES[: charts - 1]:
            page.part(f"plot-quantity-{quantity}").check()
        page.page.wait_for_timeout(max(0.0, seconds - LOOKED_AT_S) * 1e3)
        assert page.page.locator(".time-chart").count() == charts
        page.page.evaluate(WATCH)
        before_s = _browser_cpu_s()
        page.page.wait_for_timeout(min(seconds, LOOKED_AT_S) * 1e3)
        seen: dict[str, Any] = page.page.evaluate(WATCHED)
        cpu_ms = 1e3 * (_browser_cpu_s() - before_s) / seen["drawn"]
    return Watched(seen["drawn"] / seen["seconds"], cpu_ms, seen["ages_s"], seen["waits_s"])


def _browser_cpu_s() -> float:
    processes = psutil.Process().children(recursive=True)
    return sum(sum(process.cpu_times()[:2]) for process in processes if "chrom" in process.name())


def _costs(browser: Browser, server: RunningServer) -> dict[str, list[float]]:
    """Measure the server, in turns [% of a core]: without a client, a subscriber, the page."""
    process = psutil.Process(server.process.pid)
    costs_percent: dict[str, list[float]] = {"nobody": [], JOINT_STATES: [], "the page": []}
    for _ in range(TURNS):
        costs_percent["nobody"].append(_cpu_percent(process))
        costs_percent[JOINT_STATES].append(_cpu_percent(process, functools.partial(_subscribe, server)))
        with opened(browser, draws=True) as page:
            page.open(server.port)
            page.page.wait_for_timeout(WARM_UP_S * 1e3)
            watch = functools.partial(page.page.wait_for_timeout, CPU_S * 1e3)
            costs_percent["the page"].append(_cpu_percent(process, watch))
    return costs_percent


def _cpu_percent(process: psutil.Process, meanwhile: Callable[[], None] = lambda: time.sleep(CPU_S)) -> float:
    before, started_s = sum(process.cpu_times()[:2]), time.monotonic()
    meanwhile()
    return 100.0 * (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - started_s)


def _subscribe(server: RunningServer) -> None:
    with connect(server.url, max_size=None) as websocket:
        websocket.send(json.dumps({"op": "subscribe", "topic": JOINT_STATES}))
        until_s = time.monotonic() + CPU_S
        while time.monotonic() < until_s:
            websocket.recv(timeout=CPU_S)


@contextmanager
def _moving(server: RunningServer) -> Iterator[None]:
    """Send goals to and fro, one after the other, until the block ends."""
    over = threading.Event()
    mover = threading.Thread(target=_move, args=(server, over))
    mover.start()
    try:
        yield
    finally:
        over.set()
        mover.join()


def _move(server: RunningServer, over: threading.Event) -> None:
    with connect(server.url) as websocket:
        websocket.send(
            json.dumps({"op": "subscribe", "topic": "/moveit_goal_result", "type": "moveit_msgs/MoveItErrorCodes"})
        )
        turn = 0
        while not over.is_set():
            name = ("home", "ready")[turn % 2]
            websocket.send(json.dumps({"op": "publish", "topic": "/moveit_goal_named", "msg": {"data": name}}))
            if json.loads(websocket.recv(timeout=30.0))["msg"]["val"] == SUCCESS:
                turn += 1
            else:
                # On a busy machine the emulated servos may answer too late: the arm has faults.
                call(server.url, "/arm/reset_fault")
                over.wait(0.5)


def main() -> None:
    """Measure for the time that the command line gives."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page", description=main.__doc__)
    parser.add_argument("--seconds", type=float, default=WATCHED_S, help="how long the page is watched")
    parser.add_argument("--only", choices=PARTS, action="append", help="part to measure; may be given several times")
    arguments = parser.parse_args()
    run(arguments.seconds, arguments.only or PARTS)


if __name__ == "__main__":
    main()
