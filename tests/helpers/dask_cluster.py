"""A Dask cluster of processes on this machine, started by the commands of docs/cluster.md."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HOST = "127.0.0.1"


def free_port() -> int:
    with socket.create_server((HOST, 0)) as taken:
        port: int = taken.getsockname()[1]
        return port


class DaskCluster:
    """A scheduler and its workers.

    Args:
        options: of both commands.
        scheme: of the scheduler's address.
    """

    def __init__(self, *options: str, scheme: str = "tcp") -> None:
        self._options = options
        self.port = free_port()
        self.address = f"{scheme}://{HOST}:{self.port}"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []

    def start_scheduler(self) -> None:
        self.scheduler = self._start("scheduler", "--port", str(self.port), "--dashboard-address", f"{HOST}:0")

    def start_worker(self, *options: str) -> None:
        """One that takes one task at a time and is not restarted when it dies."""
        self.workers.append(self._start("worker", self.address, "--nthreads", "1", "--no-nanny", *options))

    def kill_worker(self, number: int) -> None:
        self._end(self.workers.pop(number))

    def kill_scheduler(self) -> None:
        """Its workers end with it."""
        if self.scheduler is not None:
            self._end(self.scheduler)
        for worker in self.workers:
            worker.wait(10.0)
        self.workers.clear()

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process is not None:
                self._end(process)

    def _start(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", command, *arguments, "--host", HOST, "--no-dashboard", *self._options],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "error"},
            stdin=subprocess.DEVNULL,
        )

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        process.send_signal(signal.SIGKILL)
        process.wait(10.0)
