"""The terminal of a command: results on stdout, progress and questions on stderr, answers from stdin."""

import os
import select
import sys
import termios
from collections.abc import Sequence
from enum import IntEnum

from robot.errors import RobotError

YES_OR_NO = frozenset({"yes", "no"})
YES = frozenset({"y", "yes"})

READ_BYTES = 4096

# Cursor up by a number of lines, and clear to the end of the screen (ECMA-48).
_REDRAW = "\x1b[{lines}A\x1b[J"


class ExitCode(IntEnum):
    """Exit code of a command, for scripts."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    PROBLEMS = 3


EXIT_CODES = "Exit code 0: done; 1: it could not be done; 2: called wrongly; 3: done, and problems were found."


class AnswerMissing(RobotError):  # noqa: N818 - named by the fact
    """A question had no answer: the input ended."""


class Terminal:
    """Terminal of a command: its output and its keyboard."""

    def __init__(self, input_descriptor: int = 0) -> None:
        self._input = input_descriptor
        self._received = b""
        self._live_lines = 0

    def out(self, text: str) -> None:
        """Print a result on stdout."""
        print(text, flush=True)  # noqa: T201 - the command's own output

    def err(self, text: str) -> None:
        """Print progress, or a question, on stderr."""
        self._live_lines = 0
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - the command's own output

    def show_live(self, text: str) -> None:
        """Print a table in the place of the last one; on a terminal only, a file gets nothing."""
        if not sys.stderr.isatty():
            return
        redraw = _REDRAW.format(lines=self._live_lines) if self._live_lines else ""
        print(redraw + text, file=sys.stderr, flush=True)  # noqa: T201 - the command's own output
        self._live_lines = text.count("\n") + 1

    def ask(self, question: str) -> None:
        """Print a question; keys pressed before it do not count. A pipe or file keeps the answers that it has ready."""
        if os.isatty(self._input):
            termios.tcflush(self._input, termios.TCIFLUSH)
            self._received = b""
        self.err(question)

    def confirm(self, question: str) -> bool:
        """Ask a question; whatever is not yes is no."""
        self.ask(f"{question} [y/N]")
        return self._line().strip().lower() in YES

    def await_enter(self, request: str) -> None:
        self.ask(f"{request}, then press Enter.")
        self._line()

    def line_typed(self) -> str | None:
        """Return the line that was typed since the last question, None before Enter; does not wait."""
        if b"\n" not in self._received and select.select([self._input], [], [], 0.0)[0]:
            self._receive()
        return self._line() if b"\n" in self._received else None

    def _line(self) -> str:
        while b"\n" not in self._received:
            self._receive()
        line, _, self._received = self._received.partition(b"\n")
        return line.decode(errors="replace")

    def _receive(self) -> None:
        data = os.read(self._input, READ_BYTES)
        if not data:
            raise AnswerMissing("the question was not answered: the input ended")
        self._received += data


def prompt(answers: Sequence[str]) -> str:
    """Describe the keys for the answers to a question. Enter alone answers no question about yes or no."""
    if not answers:
        return ""
    if set(answers) >= YES_OR_NO:
        return f" Type {' or '.join(answers)} and Enter."
    return f" Enter: {answers[0]}{''.join(f', or type {each!r} and Enter' for each in answers[1:])}."


def chosen(typed: str, answers: Sequence[str]) -> str:
    """Return the answer that a typed line begins, if there is one alone, the first for an empty line, else the line."""
    line = typed.strip().lower()
    if not line:
        return "" if set(answers) >= YES_OR_NO else answers[0]
    begun = [each for each in answers if each.startswith(line)]
    return begun[0] if len(begun) == 1 else line


def table(headings: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out rows below headings, in columns as wide as their widest entry."""
    cells = [list(headings), *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(headings))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells
    )
