"""A classroom as a teacher starts it, on real sockets."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil

from harness.server import FAST, ROOT, free_ports
from harness.waiting import TIMEOUT_S, until_classroom_ready


class Room:
    """A running classroom, its list and its processes."""

    def __init__(self, folder: Path, students: int, *options: str) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "server.cli", "classroom", "--students", str(students)]
        self.process = subprocess.Popen(
            [*command, "--port", str(free_ports(students)), "--data", str(folder), *options],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), **FAST},
        )
        until_classroom_ready(folder / "students.csv")

    @property
    def places(self) -> dict[str, tuple[str, str]]:
        """Address and token by name."""
        with (self.folder / "students.csv").open(newline="") as lines:
            return {row["name"]: (row["url"], row["token"]) for row in csv.DictReader(lines)}

    def url(self, name: str, token_of: str | None = None) -> str:
        return f"{self.places[name][0]}/?token={self.places[token_of or name][1]}"

    def port(self, name: str) -> int:
        return int(self.places[name][0].rsplit(":", 1)[1])

    def server(self, name: str) -> psutil.Process:
        """The process that listens on a student's port."""
        for child in psutil.Process(self.process.pid).children():
            if any(
                each.laddr.port == self.port(name) and each.status == psutil.CONN_LISTEN
                for each in child.net_connections()
            ):
                return child
        raise AssertionError(f"nobody listens for {name}")

    def end(self) -> int:
        """Press Ctrl-C; returns the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(TIMEOUT_S)
