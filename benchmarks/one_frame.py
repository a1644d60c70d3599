"""Effect of one client's costly frames on another: ``python -m benchmarks.one_frame [--search] [--role view] ...``.

A client that sends nothing more than one frame may hold up neither the joint states nor the stops of another. Without
options the frames whose cost is known are measured; ``--search`` tries a few thousand others, made of the server's own
interface tables, in larger sizes where the first tries were slow, and repeats the worst on servers of their own.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil

from benchmarks.attack_clients import ClientProcess, Observation, Order, Outcome, attack, crowd, watch
from benchmarks.costly_frames import Attack, Frame, joined, known_attacks
from benchmarks.costly_operations import operations_of_every_kind
from benchmarks.costly_requests import FIRST_SHAPES, LARGER_SHAPES, ask_interfaces, requests_of_every_type
from benchmarks.floods import DrainedLog
from harness import clients
from harness.figures import print_table
from harness.server import RunningServer
from protocol.registry import Registry

RATE_HZ = 100.0
GOAL_PAUSE_MS, GOAL_STOP_MS = 50.0, 20.0

# Time for the planner workers to load.
WARM_UP_S = 3.0
SETTLE_S = 0.3
AFTER_S = 10.0

# A server that is not held up sends states and answers stops within this time.
RESTED_S = 0.05
REST_TIMEOUT_S = 300.0
TIMEOUT_S = 600.0
POLL_S = 0.02

# An attack is given up when the server is larger than this, before it takes the machine's memory.
MAX_MEMORY_MB = 4000.0

CROWD_CLIENTS, CROWD_TOPICS = 10, 1000

# Role of the attacker and the other clients; those that only prepare show a token.
ROLES = ("admin", "view")
ADMIN_TOKEN = "0123456789abcdef"
MAX_VIEW_BYTES = 1_048_576

# In a search, a server that was held up for so long, or is so large, is replaced before the next attack.
REPLACED_FROM_MS, REPLACED_FROM_MB = 2000.0, 700.0
TRIED_LARGER = 20
SLOW_ENOUGH_MS = 2000.0


@dataclass(frozen=True)
class Patience:
    """Times of one measurement [s]: longest attack, time without an answer that ends it, and rest after it."""

    limit_s: float
    quiet_s: float
    after_s: float


THOROUGH = Patience(120.0, 1.0, AFTER_S)
HASTY = Patience(5.0, 0.1, 0.0)
REPEATED = Patience(60.0, 1.0, 0.0)


@dataclass(frozen=True)
class Measurement:
    """Effect of one attack: times in milliseconds, memory in megabytes; the pause is that beyond the period."""

    name: str
    frames: int
    size_bytes: int
    pause_ms: float
    stop_ms: float
    before_mb: float
    peak_mb: float
    after_mb: float
    seconds: float
    end: str

    def row(self) -> list[str]:
        """Return the cells of its row."""
        times = (f"{self.pause_ms:.0f}", f"{self.stop_ms:.0f}")
        memory = (f"{self.before_mb:.0f}", f"{self.peak_mb:.0f}", f"{self.after_mb:.0f}")
        return [self.name, str(self.frames), _size(self.size_bytes), *times, *memory, f"{self.seconds:.1f}", self.end]


HEADER = ("operations", "frames", "size", "pause", "stop", "MB before", "peak", "after", "answered [s]", "end")


class AttackedServer:
    """Server with a client that watches it and one that attacks it; the block ends them."""

    def __init__(self, role: str) -> None:
        self._role = role
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._stack.close()
            raise
        return self

    def _start(self) -> None:
        enter = self._stack.enter_context
        folder = enter(tempfile.TemporaryDirectory(prefix="one_frame"))
        settings = {
            "ARMBRIDGE_ARM__JOINT_STATE_RATE_HZ": f"{RATE_HZ:g}",
            "ARMBRIDGE_ACCESS__WITHOUT_TOKEN": self._role,
            "ARMBRIDGE_ACCESS__ADMIN_TOKENS": json.dumps({"admin": ADMIN_TOKEN}),
            # Nothing that an attack saves is kept.
            "ARMBRIDGE_GOALS__NAMED_STATES_FILE": str(Path(folder) / "named_states.yaml"),
            "XDG_DATA_HOME": folder,
            "HOME": folder,
        }
        self.server = enter(RunningServer(settings=settings))
        self._stack.callback(DrainedLog(self.server).close)
        self._process = psutil.Process(self.server.process.pid)
        self._stack.callback(self._kill)
        time.sleep(WARM_UP_S)
        self._watcher = enter(ClientProcess(watch, self.server.url))
        self._attacker = enter(ClientProcess(attack, self.server.url))
        self._crowded = False
        self._rest(REST_TIMEOUT_S)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._stack.close()

    def _kill(self) -> None:
        # One that is held up takes no signal to end in good order.
        for process in (self._process, *self._process.children(recursive=True)):
            process.kill()
        self.server.process.wait()

    @property
    def admin_url(self) -> str:
        """URL of the server with the administrator's token."""
        return f"{self.server.url}&token={ADMIN_TOKEN}"

    @property
    def memory_mb(self) -> float:
        """Resident memory of the server [MB]."""
        return float(self._process.memory_info().rss / 1e6)

    def measure(self, name: str, attacked: Attack, frames: Sequence[Frame], patience: Patience) -> Measurement:
        """Send frames, and measure from the first of them until the server is at rest again."""
        if attacked.crowded and not self._crowded:
            self._stack.enter_context(ClientProcess(crowd, self.admin_url, CROWD_CLIENTS, CROWD_TOPICS)).ask(
                True, TIMEOUT_S
            )
            self._crowded = True
        order = Order(joined(attacked.before), frames, patience.limit_s, patience.quiet_s)
        self._attacker.ask(order, TIMEOUT_S)
        self._rest(REST_TIMEOUT_S)
        before_mb = self.memory_mb
        _reset_peak(self._process.pid)
        self._watcher.ask(True, TIMEOUT_S)
        outcome = self._outcome(patience)
        time.sleep(SETTLE_S)
        # The attacker has left: what the server still does for it is measured as well.
        observed, is_at_rest = self._rest(patience.limit_s)
        peak_mb = _peak_mb(self._process.pid)
        time.sleep(patience.after_s)
        end = outcome.end + ", lost" * bool(observed.lost) + ", held up" * (not is_at_rest)
        return Measurement(
            name,
            len(frames),
            sum(map(len, frames)),
            (observed.pause_s - 1.0 / RATE_HZ) * 1e3,
            observed.stop_s * 1e3,
            before_mb,
            peak_mb,
            self.memory_mb,
            outcome.seconds,
            end,
        )

    def _outcome(self, patience: Patience) -> Outcome:
        """Let the attack begin; give it up when the server grows too large."""
        began_s = time.monotonic()
        self._attacker.pipe.send(True)
        while not self._attacker.pipe.poll(POLL_S):
            if self.memory_mb > MAX_MEMORY_MB or time.monotonic() > began_s + patience.limit_s + TIMEOUT_S:
                return Outcome(time.monotonic() - began_s, "given up", 0)
        outcome: Outcome = self._attacker.pipe.recv()
        return outcome

    def _rest(self, timeout_s: float) -> tuple[Observation, bool]:
        """Wait until the server is at rest; return the observation, and False when it has not come to rest in time."""
        until_s = time.monotonic() + timeout_s
        while True:
            observed: Observation = self._watcher.ask(False, TIMEOUT_S)
            is_at_rest = observed.waiting_s < RESTED_S
            if is_at_rest or time.monotonic() > until_s or self.memory_mb > MAX_MEMORY_MB:
                return observed, is_at_rest
            time.sleep(POLL_S)


def _reset_peak(pid: int) -> None:
    # proc(5): 5 resets the peak of the resident memory.
    Path(f"/proc/{pid}/clear_refs").write_text("5")


def _peak_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1.024e-3 for line in lines if line.startswith("VmHWM:"))


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.1f} MB" if size_bytes >= 50_000 else f"{size_bytes / 1e3:.1f} kB"


def run() -> None:
    """Measure the frames whose cost is known."""
    measure_known("admin")


def measure_known(role: str, only: str = "") -> list[Measurement]:
    """Measure the attacks whose cost is known, each on a server of its own, joined in one frame and as many frames."""
    with AttackedServer(role) as attacked:
        found = [attacked.measure("nothing", Attack("nothing", ()), (), Patience(10.0, 5.0, 0.0))]
    for known in known_attacks():
        if only not in known.name:
            continue
        for frames in (joined(known.operations), list(known.operations)):
            with AttackedServer(role) as attacked:
                found.append(attacked.measure(known.name, known, frames, THOROUGH))
                _note(found[-1])
    _print(f"Costly frames of one client ({role}), each on a server of its own", found)
    return found


def search(role: str, worst: int, only: str = "", results: Path | None = None) -> None:
    """Try many attacks, and print the worst of them."""
    with AttackedServer("admin") as attacked:
        url = attacked.server.url
        interfaces = ask_interfaces(lambda service, args=None: clients.call(url, service, args))
    recipes = [recipe for recipe in requests_of_every_type(Registry.load(), interfaces) if only in recipe.name]
    tries = [Try(each.name, partial(_itself, each)) for each in operations_of_every_kind() if only in each.name]
    tries += [Try(recipe.name, partial(recipe.make, shape)) for recipe in recipes for shape in recipe.shapes]
    found = [*_tried(role, tries, HASTY, results)]
    resizable = {recipe.name: recipe for recipe in recipes if recipe.shapes == FIRST_SHAPES}
    for shape in LARGER_SHAPES:
        # Those that hold the server up for seconds need not be larger.
        known = {tried.name for tried, measured in found if measured.pause_ms > SLOW_ENOUGH_MS}
        slow = [name for name in _names(found) if name in resizable and name not in known][:TRIED_LARGER]
        found += _tried(role, [Try(name, partial(resizable[name].make, shape)) for name in slow], HASTY, results)
    of_name = {tried.name: tried for tried, _ in sorted(found, key=_pause_ms)}
    again = [of_name[name] for name in _names(found)[:worst]]
    repeated = [measured for tried in again for _, measured in _tried(role, [tried], REPEATED, results)]
    _print(f"The {len(repeated)} worst of {len(found)} attacks of one client ({role})", repeated)


@dataclass(frozen=True)
class Try:
    """Attack that is made when its turn comes; its name is the same for all sizes."""

    name: str
    make: Callable[[], Attack]


def _itself(made: Attack) -> Attack:
    return made


def _pause_ms(found: tuple[Try, Measurement]) -> float:
    return max(found[1].pause_ms, found[1].stop_ms)


def _names(found: Iterable[tuple[Try, Measurement]]) -> list[str]:
    """Return the names of attacks, the slowest first."""
    return [*dict.fromkeys(tried.name for tried, _ in sorted(found, key=_pause_ms, reverse=True))]


def _tried(
    role: str, tries: Iterable[Try], patience: Patience, results: Path | None
) -> Iterator[tuple[Try, Measurement]]:
    """Try each attack, on servers that are replaced when they have suffered."""
    todo = [*tries][::-1]
    while todo:
        with AttackedServer(role) as attacked:
            suffered = False
            while todo and not suffered:
                tried = todo.pop()
                made = tried.make()
                frames = joined(made.operations)
                if role == "view" and max(map(len, frames)) > MAX_VIEW_BYTES:
                    continue
                try:
                    measured = attacked.measure(made.name, made, frames, patience)
                except (TimeoutError, EOFError, OSError) as error:
                    print(f"{made.name}: {error!r}", file=sys.stderr)
                    break
                suffered = measured.pause_ms > REPLACED_FROM_MS or attacked.memory_mb > REPLACED_FROM_MB
                _note(measured, results)
                yield tried, measured


def _note(measured: Measurement, results: Path | None = None) -> None:
    if results is not None:
        with results.open("a") as file:
            file.write(json.dumps(asdict(measured)) + "\n")
    if results is None or measured.pause_ms > GOAL_PAUSE_MS:
        print(" | ".join(measured.row()), file=sys.stderr, flush=True)


def _print(title: str, found: Sequence[Measurement]) -> None:
    print_table(
        f"{title}: longest pause of /joint_states beyond its period, slowest stop [ms]",
        HEADER,
        [each.row() for each in found],
    )
    print(f"Goal: pauses of at most {GOAL_PAUSE_MS:g} ms and stops within {GOAL_STOP_MS:g} ms, on a quiet machine.")


def main() -> None:
    """Measure the effect of one client's costly frames on another one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.one_frame", description=main.__doc__)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--quick", action="store_true", help="measure the frames whose cost is known (default)")
    kind.add_argument("--search", action="store_true", help="search for others")
    parser.add_argument("--role", choices=ROLES, default="admin", help="role of the attacker")
    parser.add_argument("--only", default="", metavar="TEXT", help="attacks whose name contains it")
    parser.add_argument("--worst", type=int, default=15, metavar="N", help="number of attacks that a search prints")
    parser.add_argument("--results", type=Path, metavar="FILE", help="gets a line of JSON for each attack of a search")
    options = parser.parse_args()
    if options.search:
        search(options.role, options.worst, options.only, options.results)
    else:
        measure_known(options.role, options.only)


if __name__ == "__main__":
    main()
