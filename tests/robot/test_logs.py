import gc
import json
import logging
from datetime import datetime
from typing import Any

import pytest

from robot import logs
from robot.logs import (
    BURST,
    LINES_PER_S,
    MAX_CHANGED_LOGGERS,
    MAX_KEYS,
    FloodFilter,
    JsonFormatter,
    LoggerLevel,
    LogLimiter,
    PlainFormatter,
)
from tests.helpers.programs import run_python


def record(text: str, *values: Any, error: BaseException | None = None) -> logging.LogRecord:
    raised = None if error is None else (type(error), error, None)
    return logging.LogRecord("armbridge.arm", logging.WARNING, "arm.py", 7, text, values, raised)


def as_json(made: logging.LogRecord) -> dict[str, Any]:
    line = JsonFormatter("server").format(made)
    assert "\n" not in line
    fields: dict[str, Any] = json.loads(line)
    return fields


def test_a_json_line_has_time_process_and_message() -> None:
    made = record("%s is hot", "elbow_flex")
    fields = as_json(made)
    time = datetime.fromisoformat(fields.pop("time"))
    assert time.utcoffset() is not None
    assert time.timestamp() == pytest.approx(made.created, abs=0.001)
    assert fields == {
        "level": "warning",
        "logger": "armbridge.arm",
        "message": "elbow_flex is hot",
        "process": "server",
        "pid": made.process,
    }


def test_a_json_line_has_the_subjects_of_its_message() -> None:
    made = record("goal %s", "7")
    vars(made).update(goal="7", client="", code="SUCCESS", other="x")
    fields = as_json(made)
    assert (fields["goal"], fields["code"]) == ("7", "SUCCESS")
    assert not {"client", "other"} & fields.keys()


def test_a_traceback_stays_within_its_json_line() -> None:
    fields = as_json(record("failed", error=ValueError("two\nlines")))
    assert fields["exception"].startswith("ValueError: two\nlines")


def test_a_plain_line_is_for_people_and_names_one_of_several_arms() -> None:
    assert PlainFormatter().format(record("hot")).endswith("WARNING armbridge.arm: hot")
    assert PlainFormatter("left").format(record("hot")).endswith("WARNING armbridge.arm: left: hot")


SECRETS = {
    "query": "GET /?ros=1&token=s3cret-s3cret HTTP/1.1",
    "first in a query": "ws://host/?token=s3cret-s3cret&ros=1",
    "header": "Authorization: Bearer s3cret-s3cret",
    "access_token": "/metrics?access_token=s3cret-s3cret",
}


@pytest.mark.parametrize("text", SECRETS.values(), ids=SECRETS.keys())
def test_a_token_is_blotted_out_in_every_format(text: str) -> None:
    made = record("%s", text, error=ValueError(text))
    for line in (PlainFormatter().format(made), JsonFormatter("server").format(made)):
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
def test_nobody_writes_lines_of_its_own_into_the_plain_log(text: str) -> None:
    line = PlainFormatter().format(record("closed: %s", text))
    assert line.isprintable()
    assert line.endswith(f"closed: {text}".encode("unicode_escape").decode())


def test_a_very_long_message_is_cut_and_its_length_noted() -> None:
    made = record("no group %s", "x" * 5_000_000)
    for line in (PlainFormatter().format(made), as_json(made)["message"]):
        assert len(line) < logs.MAX_MESSAGE_CHARACTERS + 100
        assert line.endswith("... (5000009 characters)")


NAME = "armbridge.test_log_levels"


class Child:
    """Hears what it is sent."""

    def __init__(self) -> None:
        self.heard: list[object] = []

    def send(self, message: object) -> None:
        self.heard.append(message)


@pytest.fixture(autouse=True)
def nothing_is_changed_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "_changed", {})


def test_an_unreferenced_child_is_forgotten() -> None:
    count = len(logs._followers)
    child = Child()
    logs.follow(child)
    del child
    gc.collect()
    assert len(logs._followers) <= count


def test_not_more_loggers_are_changed_than_there_may_be() -> None:
    changes = [LoggerLevel(f"{NAME}.l{number}", 0) for number in range(MAX_CHANGED_LOGGERS + 1)]
    assert [logs.change(each) for each in changes] == [True] * MAX_CHANGED_LOGGERS + [False]
    assert logs.change(changes[0])


@pytest.mark.parametrize(
    ("limiter", "lines"),
    [
        (LogLimiter(3, 0.5), [("a", 0.0, True)] * 3 + [("a", 0.0, False)] * 2 + [("a", 2.0, True), ("a", 2.0, False)]),
        (LogLimiter(2, 1.0), [("a", 0.0, True), ("a", 1e6, True), ("a", 1e6, True), ("a", 1e6, False)]),
        (LogLimiter(1, 0.0), [("a", 0.0, True), ("b", 0.0, True), ("a", 1e9, False)]),
    ],
    ids=["a burst and then the rate", "never more than the burst", "each key for itself"],
)
def test_lines_are_due_in_bursts_and_then_at_a_rate(limiter: LogLimiter, lines: list[tuple[str, float, bool]]) -> None:
    assert [limiter.due(key, now_s) for key, now_s, _ in lines] == [due for _, _, due in lines]


LOG = logging.getLogger("armbridge.test")


def test_a_flood_of_lines_is_cut_short_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    limiter = LogLimiter(burst=50, lines_per_s=1.0)
    for number in range(80):
        limiter.write(LOG, logging.WARNING, f"client x: refused: {number}", "x", 10.0)
    assert caplog.messages == [f"client x: refused: {number}" for number in range(50)]
    limiter.write(LOG, logging.WARNING, "client x: refused: later", "x", 11.0)
    assert caplog.messages[-1] == "client x: refused: later (30 more lines like this were left out before)"


def test_keys_that_clients_choose_are_bounded_and_the_end_is_told(caplog: pytest.LogCaptureFixture) -> None:
    limiter = LogLimiter()
    for number in range(2 * MAX_KEYS):
        limiter.write(LOG, logging.WARNING, "refused: no", ("origin", f"{number}" + "x" * 100_000))
    assert len(caplog.records) == MAX_KEYS + 1
    assert caplog.messages[-1] == f"{MAX_KEYS} lines of this kind were written; further ones are not"
    assert len(limiter._buckets) == MAX_KEYS
    assert all(isinstance(key, int) for key in limiter._buckets)


def test_a_line_names_the_place_that_writes_it(caplog: pytest.LogCaptureFixture) -> None:
    LogLimiter().write(LOG, logging.WARNING, "refused: no", "x")
    assert caplog.records[0].pathname == __file__


def test_the_next_line_has_the_number_of_suppressed_ones() -> None:
    now_s = [0.0]
    flood = FloodFilter(lambda: now_s[0])
    for _ in range(BURST + 3):
        flood.filter(record("hot"))
    now_s[0] = 1.0 / LINES_PER_S
    after = record("hot")
    assert flood.filter(after)
    line = PlainFormatter().format(after)
    assert line.endswith("hot (3 more lines like this were left out before)")
    assert PlainFormatter().format(record("hot")).endswith("hot")


def test_every_process_logs_through_it() -> None:
    root = logging.getLogger()
    former, root.handlers = root.handlers, []
    try:
        logs.configure("INFO", "plain")
        assert [type(each) for each in root.handlers[0].filters] == [FloodFilter]
    finally:
        root.handlers = former
