"""The servo-bus emulator as a child of the server: the simulated arm is the real driver on this bus."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import subprocess
from pathlib import Path

from robot.processes import start_module
from server.config import EmulatorSettings
from server.errors import StartError

# Starting an interpreter takes a tenth of a second; a loaded machine may take many times that.
START_TIMEOUT_S = 10.0

# It ends by itself one second after its bus falls silent.
END_TIMEOUT_S = 3.0


class EmulatedBus:
    """One emulator process and the port it offers.

    Args:
        settings: faults and log.
        calibration: of the arm to simulate, or None for an ideal one.
    """

    def __init__(self, settings: EmulatorSettings, calibration: Path | None) -> None:
        self._settings = settings
        self._calibration = calibration
        self._process: subprocess.Popen[bytes] | None = None
        self._writer: asyncio.StreamWriter | None = None

    @property
    def pid(self) -> int | None:
        """Process id."""
        return None if self._process is None else self._process.pid

    async def start(self) -> str:
        """Start the emulator and return its serial port.

        Raises:
            StartError: it did not come up.
        """
        ours, theirs = socket.socketpair()
        with theirs:
            arguments = [*self._arguments(), "--control-fd", str(theirs.fileno())]
            self._process = start_module("robot.emulator", arguments, (theirs.fileno(),))
        reader, self._writer = await asyncio.open_unix_connection(sock=ours)
        try:
            line = await asyncio.wait_for(reader.readline(), START_TIMEOUT_S)
            return str(json.loads(line)["port"])
        except (TimeoutError, ValueError, KeyError) as error:
            raise StartError(f"the servo-bus emulator did not start: {error!r}") from error

    async def close(self) -> None:
        """Let the emulator end, once the arm process has left the bus."""
        if self._writer is not None:
            self._writer.close()
        if self._process is None:
            return
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.terminate()
            await asyncio.to_thread(self._process.wait, END_TIMEOUT_S)
        if self._process.poll() is None:
            self._process.kill()
            await asyncio.to_thread(self._process.wait, END_TIMEOUT_S)

    def _arguments(self) -> list[str]:
        settings = self._settings
        arguments = [
            "--drop",
            str(settings.drop),
            "--corrupt",
            str(settings.corrupt),
            "--seed",
            str(settings.seed),
        ]
        if self._calibration is not None:
            arguments += ["--calibration", str(self._calibration)]
        if settings.write_log is not None:
            arguments += ["--write-log", str(settings.write_log)]
        return arguments
