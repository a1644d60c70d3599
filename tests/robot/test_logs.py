"""Logs and other files."""

import json
import logging
import os
import select
import socket
import subprocess
import sys
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from harness.waiting import TIMEOUT_S, running
from robot import files, logs
from robot.files import FileLock, FileLockedError, lock_path, locked, replace
from tests.helpers.programs import run_python


def record(text: str, *values: Any, error: BaseException | None = None) -> logging.LogRecord:
    raised = None if error is None else (type(error), error, None)
    return logging.LogRecord("armbridge.arm", logging.WARNING, "arm.py", 7, text, values, raised)


def as_json(made: logging.LogRecord) -> dict[str, Any]:
    line = logs.JsonFormatter("server").format(made)
    assert "\n" not in line
    fields: dict[str, Any] = json.loads(line)
    return fields


def test_a_json_line_has_time_process_and_message_with_its_subjects_and_a_whole_traceback() -> None:
    made = record("%s is hot", "elbow_flex")
    fields = as_json(made)
    time = datetime.fromisoformat(fields.pop("time"))
    assert time.utcoffset() is not None
    assert time.timestamp() == pytest.approx(made.created, abs=0.001)
    words = {"level": "warning", "logger": "armbridge.arm", "message": "elbow_flex is hot"}
    assert fields == words | {"process": "server", "pid": made.process}
    made = record("goal %s", "7", error=ValueError("two\nlines"))
    vars(made).update(goal="7", client="", code="SUCCESS", other="x")
    fields = as_json(made)
    assert (fields["goal"], fields["code"]) == ("7", "SUCCESS")
    assert not {"client", "other"} & fields.keys()
    assert fields["exception"].startswith("ValueError: two\nlines")


SECRETS = (
    "GET /?ros=1&token=s3cret-s3cret HTTP/1.1",
    "ws://host/?token=s3cret-s3cret&ros=1",
    "Authorization: Bearer s3cret-s3cret",
    "/metrics?access_token=s3cret-s3cret",
)


@pytest.mark.parametrize("text", SECRETS)
def test_a_token_is_blotted_out_in_every_format(text: str) -> None:
    made = record("%s", text, error=ValueError(text))
    for line in (logs.PlainFormatter().format(made), logs.JsonFormatter("server").format(made)):
        assert "s3cret" not in line
        assert "***" in line


def test_a_process_that_ends_by_an_exception_says_so_in_json() -> None:
    program = """
from robot import logs
before = logs.format_in_use()
logs.configure("INFO", "json")
raise OSError(f"{before}, then {logs.format_in_use()}")
"""
    line = json.loads(run_python(program).stderr)
    assert (line["level"], line["message"]) == ("critical", "ended by an exception")
    assert "OSError: plain, then json" in line["exception"]


@pytest.mark.parametrize("text", ["bye\n2026-01-01 ERROR armbridge: the arm burns", "\x1b[2Jgone", "a\rb"])
def test_a_plain_line_names_one_of_several_arms_and_nobody_writes_lines_of_its_own(text: str) -> None:
    assert logs.PlainFormatter().format(record("hot")).endswith("WARNING armbridge.arm: hot")
    assert logs.PlainFormatter("left").format(record("hot")).endswith("WARNING armbridge.arm: left: hot")
    line = logs.PlainFormatter().format(record("closed: %s", text))
    assert line.isprintable()
    assert line.endswith(f"closed: {text}".encode("unicode_escape").decode())


def test_a_very_long_message_is_cut_and_its_length_noted() -> None:
    made = record("no group %s", "x" * 5_000_000)
    for line in (logs.PlainFormatter().format(made), as_json(made)["message"]):
        assert len(line) < logs.MAX_MESSAGE_CHARACTERS + 100
        assert line.endswith("... (5000009 characters)")


NAME = "armbridge.test_log_levels"


class Child:
    """A child process that drops every message."""

    def send(self, message: object) -> None:
        return


def test_loggers_that_are_changed_are_bounded_and_children_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "_changed", {})
    changes = [logs.LoggerLevel(f"{NAME}.l{number}", 0) for number in range(logs.MAX_CHANGED_LOGGERS + 1)]
    assert [logs.change(each) for each in changes] == [True] * logs.MAX_CHANGED_LOGGERS + [False]
    assert logs.change(changes[0])
    # Names that somebody made up do not keep the program's own loggers from being changed.
    logging.getLogger(f"{NAME}.place.own")
    assert logs.change(logs.LoggerLevel(f"{NAME}.place.own", 0))
    assert not logs.change(logs.LoggerLevel(f"{NAME}.place", 0))
    count = len(logs._followers)
    child = Child()
    logs.follow(child)
    del child
    assert len(logs._followers) <= count


def test_lines_are_due_in_bursts_and_then_at_a_rate() -> None:
    for burst, lines_per_s, lines in (
        (3, 0.5, [("a", 0.0, True)] * 3 + [("a", 0.0, False)] * 2 + [("a", 2.0, True), ("a", 2.0, False)]),
        (2, 1.0, [("a", 0.0, True), ("a", 1e6, True), ("a", 1e6, True), ("a", 1e6, False)]),
        (1, 0.0, [("a", 0.0, True), ("b", 0.0, True), ("a", 1e9, False)]),
    ):
        limiter = logs.LogLimiter(burst, lines_per_s)
        assert [limiter.due(key, now_s) for key, now_s, _ in lines] == [due for _, _, due in lines]


LOG = logging.getLogger("armbridge.test")


def test_a_flood_of_lines_is_cut_short_and_counted(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    limiter = logs.LogLimiter(burst=50, lines_per_s=1.0)
    for number in range(80):
        limiter.write(LOG, logging.WARNING, f"client x: refused: {number}", "x", 10.0)
    assert caplog.messages == [f"client x: refused: {number}" for number in range(50)]
    assert caplog.records[0].pathname == __file__
    limiter.write(LOG, logging.WARNING, "client x: refused: later", "x", 11.0)
    assert caplog.messages[-1] == "client x: refused: later (30 more lines like this were left out before)"
    # So it is in every process, by a filter.
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    logs.configure("INFO", "plain")
    assert [type(each) for each in root.handlers[0].filters] == [logs.FloodFilter]
    now_s = [0.0]
    flood = logs.FloodFilter(lambda: now_s[0])
    for _ in range(logs.BURST + 3):
        flood.filter(record("hot"))
    now_s[0] = 1.0 / logs.LINES_PER_S
    after = record("hot")
    assert flood.filter(after)
    assert logs.PlainFormatter().format(after).endswith("hot (3 more lines like this were left out before)")


def test_keys_that_clients_choose_are_bounded_and_the_end_is_told(caplog: pytest.LogCaptureFixture) -> None:
    limiter = logs.LogLimiter()
    for number in range(2 * logs.MAX_KEYS):
        limiter.write(LOG, logging.WARNING, "refused: no", ("origin", f"{number}" + "x" * 100_000))
    assert len(caplog.records) == logs.MAX_KEYS + 1
    assert caplog.messages[-1] == f"{logs.MAX_KEYS} lines of this kind were written; further ones are not"
    assert len(limiter._buckets) == logs.MAX_KEYS
    assert all(isinstance(key, int) for key in limiter._buckets)


LOGGER = """
import logging
from robot import logs
logs.configure("INFO", "plain")
for number in range(logs.BURST):
    logging.info("line %d %s", number, 500 * "x")
print("done", flush=True)
input()
logging.info("the last")
"""


@pytest.mark.parametrize("made", [os.pipe, os.openpty, lambda: [each.detach() for each in socket.socketpair()]])
def test_a_log_that_nobody_reads_holds_nobody_up_and_says_how_much_is_missing(made: Any) -> None:
    read_end, write_end = made()
    command = [sys.executable, "-c", LOGGER]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=write_end) as logger:
        assert logger.stdout.readline() == "done\n"
        os.close(write_end)
        read = b""
        while select.select([read_end], [], [], 0.0)[0]:
            read += os.read(read_end, 65_536)
        logger.stdin.write("\n")
        logger.stdin.flush()
        while b"the last" not in read:
            read += os.read(read_end, 65_536)
        logger.wait(TIMEOUT_S)
    os.close(read_end)
    lines = read.decode().splitlines()
    assert "more lines like this were left out before" in lines[-1]
    assert lines[0].endswith("xxx")


HOLDER = """
import sys
from pathlib import Path
from robot.files import FileLock
FileLock(Path(sys.argv[1])).acquire()
lock = FileLock(Path(sys.argv[2]))
lock.acquire()
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept" / "states.json"


def test_a_lock_that_another_process_has_is_refused_with_its_number_and_free_after_its_death(path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(path.with_name("other")), str(path)]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(FileLockedError) as raised:
            FileLock(path).acquire()
        assert raised.value.strerror == f"is in use by armbridge (process {holder.pid})"
        holder.kill()
        holder.wait(TIMEOUT_S)
        FileLock(path).acquire()


def test_a_lock_is_waited_for_no_longer_than_its_time(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = FileLock(path)
    held.acquire()
    times = iter((0.0, 1.0, 1.9, 2.0))
    with pytest.raises(FileLockedError):
        FileLock(path).acquire(2.0, lambda: next(times))
    assert list(times) == []
    threading.Timer(0.05, held.release).start()
    with locked(path):
        pass
    # It keeps threads of one process from each other.
    monkeypatch.setattr(files, "LOCK_TIMEOUT_S", 0.0)
    with locked(path), pytest.raises(FileLockedError, match=str(os.getpid())), locked(path):
        pass
    with locked(path):
        pass


def test_a_file_is_replaced_as_a_whole_and_all_its_names_have_one_lock(tmp_path: Path) -> None:
    path, link = tmp_path / "states.json", tmp_path / "link.json"
    for content in (b"old", b"new"):
        replace(path, content)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"new", [path])
    link.symlink_to(path)
    replace(link, b"newer")
    assert (link.is_symlink(), path.read_bytes()) == (True, b"newer")
    assert lock_path(link) == lock_path(tmp_path / "sub" / ".." / "states.json") == tmp_path / ".states.json.lock"


def test_what_cannot_be_written_leaves_the_old_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "states.json"
    replace(path, b"old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        replace(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
