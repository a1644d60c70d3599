"""The servo-bus emulator as a child of the server: the simulated arm is the real driver on this bus."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path

from robot.processes import has_ended, start_module
from server.config import EmulatorSettings
from server.errors import StartError

log = logging.getLogger("armbridge.emulator")

# A process that dies at once must not be restarted in a tight loop.
RESTART_DELAY_S = 0.3

READ_BYTES = 4096

# Starting an interpreter takes a tenth of a second; a loaded machine may take many times that.
START_TIMEOUT_S = 10.0

END_TIMEOUT_S = 1.0

# Ended by force it is gone in milliseconds.
KILL_TIMEOUT_S = 0.2


class EmulatedBus:
    """One emulator process and the port it offers.

    Args:
        settings: faults and log.
        calibration: of the arm to simulate, or None for an ideal one.
        on_port: called with the port of an emulator that took the place of one that had died.
    """

    def __init__(
        self,
        settings: EmulatorSettings,
        calibration: Path | None,
        on_port: Callable[[str], None] = lambda _port: None,
    ) -> None:
        self._settings = settings
        self._calibration = calibration
        self._on_port = on_port
        self._watching: asyncio.Task[None] | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    @property
    def pid(self) -> int | None:
        """Process id."""
        return None if self._process is None else self._process.pid

    async def launch(self) -> None:
        """Start the emulator, without waiting for it."""
        ours, theirs = socket.socketpair()
        with theirs:
            arguments = [*self._arguments(), "--control-fd", str(theirs.fileno())]
            self._process = start_module("robot.emulator", arguments, (theirs.fileno(),))
        self._reader, self._writer = await asyncio.open_unix_connection(sock=ours)

    async def start(self) -> str:
        """Start the emulator, unless that was done, and return its serial port.

        Raises:
            StartError: it did not come up.
        """
        if self._reader is None:
            await self.launch()
        port = await self._port()
        self._watching = asyncio.create_task(self._watch(), name="watch the emulator")
        return port

    async def _port(self) -> str:
        try:
            line = await asyncio.wait_for(self._announced(), START_TIMEOUT_S)
            return str(json.loads(line)["port"])
        except (TimeoutError, ValueError, KeyError) as error:
            raise StartError(f"the servo-bus emulator did not start: {error!r}") from error

    async def close(self) -> None:
        """Let the emulator end, once the arm process has left the bus."""
        if self._watching is not None:
            self._watching.cancel()
        if self._writer is not None:
            self._writer.close()
        if self._process is None:
            return
        try:
            self._process.terminate()
            await has_ended(self._process, END_TIMEOUT_S)
        finally:
            # Also when there is no more time to wait.
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait(KILL_TIMEOUT_S)

    async def _watch(self) -> None:
        """Start another emulator when this one dies, again and again, with a pause in between."""
        while True:
            await self._until_gone()
            log.error("the simulated arm's process ended; starting it again")
            await asyncio.sleep(RESTART_DELAY_S)
            try:
                await self.launch()
                port = await self._port()
            except (StartError, OSError) as error:
                log.error("%s", error)  # noqa: TRY400 - what matters is the sentence
            else:
                self._on_port(port)

    async def _until_gone(self) -> None:
        with contextlib.suppress(OSError):
            while self._reader is not None and await self._reader.read(READ_BYTES):
                pass
        if self._writer is not None:
            self._writer.close()
        if self._process is not None and not await has_ended(self._process, END_TIMEOUT_S):
            self._process.kill()

    async def _announced(self) -> bytes:
        """What the emulator says first."""
        return b"" if self._reader is None else await self._reader.readline()

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
