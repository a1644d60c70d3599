"""Emulated servos on a pseudo terminal, in real time, in a process of their own."""

import json
import socket
import subprocess
import sys

from harness.waiting import TIMEOUT_S

# ``armbridge emulate`` without the other commands, which take as long to load as it does.
EMULATE = """
import argparse
from robot.emulator import process
parser = argparse.ArgumentParser()
process.add_options(parser)
process.run(parser.parse_args())
"""


class RunningEmulator:
    """An emulator process and the test's end of its control socket."""

    def __init__(self, *options: str) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", EMULATE, "--control-fd", str(theirs.fileno()), *options],
                pass_fds=[theirs.fileno()],
            )
        ours.settimeout(TIMEOUT_S)
        self._socket = ours
        self._lines = ours.makefile("rb")
        self.port: str = json.loads(self._lines.readline())["port"]

    def command(self, **command: object) -> dict[str, object]:
        """Send one live command and return the answer."""
        self._socket.sendall(json.dumps(command).encode() + b"\n")
        answer: dict[str, object] = json.loads(self._lines.readline())
        return answer

    def let_go(self) -> None:
        """Close the control socket."""
        self._lines.close()
        self._socket.close()

    def end(self) -> None:
        """End the process, whatever it does."""
        self.let_go()
        self.process.terminate()
        try:
            self.process.wait(TIMEOUT_S)
        finally:
            self.process.kill()
