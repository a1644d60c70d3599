"""Programs that use an MCP server for a language model, in environments of their own."""

import itertools
import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from harness.waiting import TIMEOUT_S, killed_in_time

PROGRAM = Path(__file__).with_name("agent_scenario.py")


@dataclass
class Answer:
    """A tool's answer: its texts, and the kinds of its other parts."""

    parts: list[str]
    is_error: bool

    @property
    def text(self) -> str:
        return " ".join(self.parts)


class Agent:
    """A running program; the person beside it answers each question at once, or later where ``approves`` is None."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.questions: list[str] = []
        self.approves: bool | None = True
        self._process = process
        self._numbers = itertools.count(1)
        self._results: dict[int, dict[str, Any]] = {}

    def begin(self, method: str, *arguments: Any) -> int:
        """Begin a call of a method of the session."""
        number = next(self._numbers)
        self._say(number, method, *arguments)
        return number

    def end(self, number: int) -> dict[str, Any]:
        """Return the result of a call that was begun."""
        while number not in self._results:
            self._read()
        return self._results.pop(number)

    def begin_tool(self, tool: str, **arguments: Any) -> int:
        return self.begin("call_tool", tool, arguments)

    def end_tool(self, number: int) -> Answer:
        result = self.end(number)
        parts = [part["text"] if part["type"] == "text" else part["type"] for part in result["content"]]
        return Answer(parts, bool(result["isError"]))

    def __call__(self, tool: str, /, **arguments: Any) -> Answer:
        """Call a tool."""
        return self.end_tool(self.begin_tool(tool, **arguments))

    def until_asked(self) -> None:
        """Wait for the next question."""
        count = len(self.questions)
        while len(self.questions) == count:
            self._read()

    def answer(self, approves: bool) -> None:
        self._say(0, approves)

    def _say(self, *words: Any) -> None:
        assert self._process.stdin is not None
        print(json.dumps(words), file=self._process.stdin, flush=True)

    def _read(self) -> None:
        assert self._process.stdout is not None
        with killed_in_time(self._process):
            number, told = json.loads(self._process.stdout.readline())
        if number:
            self._results[number] = told
            return
        self.questions.append(told)
        if self.approves is not None:
            self.answer(self.approves)


@contextmanager
def agent_of(python: Path, mode: str, *target: str, cwd: Path | None = None, **environment: str) -> Iterator[Agent]:
    """Run a program in an environment; the target is a program of the same environment with its options, or an URL."""
    if not target[0].startswith("http"):
        target = (str(python.with_name(target[0])), *target[1:])
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    command = [python, PROGRAM, mode, *target]
    with subprocess.Popen(command, text=True, cwd=cwd, env={**os.environ, **environment}, **pipes) as process:
        # All tests of a module have one agent: its time begins with each read.
        try:
            yield Agent(process)
            assert process.stdin is not None
            process.stdin.close()
            assert process.wait(TIMEOUT_S) == 0
        finally:
            process.kill()
