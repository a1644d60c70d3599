"""A Dask cluster of processes on this machine, started by the commands of docs/planning.md."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

from harness.server import ROOT, free_port
from tests.helpers.resources import Pair

HOST = "127.0.0.1"
START_TIMEOUT_S = 60.0


class DaskCluster:
    """A scheduler and its workers; each takes one problem at a time and is not restarted when it dies."""

    def __init__(self, workers: int, certificate: Pair | None = None) -> None:
        self._port = free_port()
        self.address = f"{'tls' if certificate else 'tcp'}://{HOST}:{self._port}"
        self._certificate = certificate
        self.scheduler = self._start("scheduler", "--port", str(self._port), "--dashboard-address", f"{HOST}:0")
        self.workers = [self._start("worker", self.address, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
        self._wait_until_started()

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            self.kill(process)

    def kill(self, process: subprocess.Popen[bytes]) -> None:
        process.send_signal(signal.SIGKILL)
        process.wait(10.0)

    def _wait_until_started(self) -> None:
        from distributed import Client
        from distributed.security import Security

        # Dask's own attempts come further and further apart.
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while not self._answers() and time.monotonic() < deadline_s:
            time.sleep(0.05)
        security = None
        if self._certificate:
            file, key = map(str, self._certificate)
            security = Security(tls_ca_file=file, tls_client_cert=file, tls_client_key=key, require_encryption=True)
        with Client(self.address, timeout=START_TIMEOUT_S, security=security) as client:
            if self.workers:
                client.wait_for_workers(len(self.workers), timeout=START_TIMEOUT_S)

    def _answers(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex((HOST, self._port)) == 0

    def _start(self, command: str, *arguments: str) -> subprocess.Popen[bytes]:
        options = ["--host", HOST, "--no-dashboard"]
        if self._certificate:
            file, key = map(str, self._certificate)
            options += ["--tls-ca-file", file, "--tls-cert", file, "--tls-key", key]
        return subprocess.Popen(
            [sys.executable, "-m", "dask", command, *arguments, *options],
            cwd=ROOT,
            env={**os.environ, "PYTHONPATH": str(ROOT), "DASK_LOGGING__DISTRIBUTED": "critical"},
            stdin=subprocess.DEVNULL,
        )
