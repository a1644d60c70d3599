"""A running ``armbridge serve``, started by the command behind ``make run``, and commands to its simulated arm."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import random
import re
import shlex
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from harness.waiting import TIMEOUT_S, wait_until

ROOT = Path(__file__).parents[1]
# Reference data beside the checkout; the meshes of the published SO-101 are part of it.
REFERENCE = ROOT.parent / "shared" / "data"

# The arm, or each of several, moves as fast as its limits allow; the settings of one arm are none of several.
FAST_ARMS = {"ARMBRIDGE_MOVEIT__MAX_VELOCITY_SCALING": "1", "ARMBRIDGE_MOVEIT__MAX_ACCELERATION_SCALING": "1"}
FAST = {**FAST_ARMS, "ARMBRIDGE_ARM__UNVERIFIED_SPEED_LIMIT": "1"}

# Environment of a program that uses the Python client of this checkout, installed or not.
CLIENT_ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "clients" / "python")}

# On a starved machine a client pauses for longer than the 10 s after which its control of the arm ends.
PATIENT = {"ARMBRIDGE_ACCESS__CONTROL_IDLE_S": "3600"}

READY = re.compile(r"armbridge is ready: ws://[^:]+:(\d+)")


# Stands for the arguments, so that make, which takes 0.13 s, is asked once.
ARGUMENTS = "@arguments@"


@functools.cache
def _run_line() -> str:
    dry = subprocess.run(
        ["make", "--no-print-directory", "-n", "-o", "install", "run", f"ARGS={ARGUMENTS}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=TIMEOUT_S,
    )
    return dry.stdout.strip().splitlines()[-1].removeprefix("exec ")


def run_command(arguments: str) -> list[str]:
    """The command line behind ``make run ARGS=...``."""
    return shlex.split(_run_line().replace(ARGUMENTS, arguments))


@dataclass
class RunningServer:
    """One server process; everything it logs is kept in ``lines``.

    Attributes:
        prefix: command that runs the server's.
        program: an installed ``armbridge``, run in a folder without sources; None for that of the checkout.
    """

    arguments: str = "--port 0"
    settings: dict[str, str] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    prefix: tuple[str, ...] = ()
    program: Path | None = None

    def __enter__(self) -> RunningServer:
        self._ready = threading.Event()
        self.port = 0
        # What a server keeps for its next start is no other server's, and not the user's.
        self._data = tempfile.TemporaryDirectory(prefix="armbridge")
        self.process = subprocess.Popen(
            [*self.prefix, *self._command()],
            cwd=ROOT if self.program is None else self._data.name,
            env={**os.environ, "XDG_DATA_HOME": self._data.name, **PATIENT, **self.settings},
            stderr=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._ready.wait(TIMEOUT_S)
        if not self.port:
            self.process.kill()
            self.__exit__()
            raise AssertionError("the server did not start:\n" + "\n".join(self.lines))
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self.process.poll() is None:
                self.end(signal.SIGTERM)
        finally:
            # A server that does not end fails its test, and outlives it no longer.
            self.process.kill()
            self.process.wait()
        self._reader.join(5.0)
        assert self.process.stderr is not None
        self.process.stderr.close()
        self._data.cleanup()

    def _command(self) -> list[str]:
        if self.program is None:
            return run_command(self.arguments)
        return [str(self.program), "serve", *shlex.split(self.arguments)]

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}/?x=1"

    def end(self, number: signal.Signals) -> tuple[int, float]:
        """Send a signal and wait; returns exit code and how long it took [s]."""
        started_s = time.monotonic()
        self.process.send_signal(number)
        code = self.process.wait(TIMEOUT_S)
        return code, time.monotonic() - started_s

    def has_logged(self, text: str) -> bool:
        """Wait for a line with a text; returns false if none comes."""
        with contextlib.suppress(AssertionError):
            wait_until(lambda: any(text in line for line in list(self.lines)))
            return True
        return False

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line.rstrip())
            found = READY.search(line)
            if found:
                self.port = int(found[1])
                self._ready.set()
        # A server that has ended before it was ready is waited for no longer.
        self._ready.set()


# Below those that the kernel gives to connections, which would take a port between its choice and its use.
PORTS = range(10_000, 32_768)


def free_port() -> int:
    """A TCP port that nobody listens on."""
    return free_ports(1)


def free_ports(count: int) -> int:
    """The first of TCP ports in a row that nobody listens on."""
    while True:
        first = random.SystemRandom().choice(PORTS)
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            for port in range(first, first + count):
                stack.enter_context(socket.socket()).bind(("127.0.0.1", port))
            return first


def read_write_log(path: Path) -> list[dict[str, Any]]:
    """The emulator's log of every write to a servo, oldest first."""
    # The last line may be on its way into the file.
    *whole, _ = path.read_text().split("\n")
    return [json.loads(line) for line in whole]


class EmulatorControl:
    """A controller of the emulated servos whose control socket is at a path; connects anew for each command."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def command(self, **command: object) -> dict[str, object]:
        """Send one live command and return the answer."""
        with self._connected() as controller, controller.makefile("rb") as lines:
            controller.sendall(json.dumps(command).encode() + b"\n")
            answer: dict[str, object] = json.loads(lines.readline())
        return answer

    def _connected(self) -> socket.socket:
        until_s = time.monotonic() + TIMEOUT_S
        while True:
            controller = socket.socket(socket.AF_UNIX)
            controller.settimeout(TIMEOUT_S)
            try:
                controller.connect(str(self.path))
            except OSError:
                # An arm process that was killed is being replaced.
                controller.close()
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.01)
            else:
                return controller


@dataclass
class ServerOnBus:
    """A running server and the emulated servos of its arm."""

    server: RunningServer
    emulator: EmulatorControl


@contextmanager
def server_on_bus(arguments: str = "--port 0", **settings: str) -> Iterator[ServerOnBus]:
    """Start a server; settings are environment variables without ``ARMBRIDGE_``."""
    # A short path: that of a Unix socket has 107 bytes at most, and pytest's folders are deep.
    with tempfile.TemporaryDirectory(prefix="arm") as folder:
        control = Path(folder) / "control"
        settings = {"EMULATOR__CONTROL": str(control), **settings}
        with RunningServer(arguments, {f"ARMBRIDGE_{key}": value for key, value in settings.items()}) as server:
            yield ServerOnBus(server, EmulatorControl(control))
