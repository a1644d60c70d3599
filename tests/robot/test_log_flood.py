from __future__ import annotations

import logging

from robot import logs
from robot.logs import BURST, LINES_PER_S, FloodFilter


def record(line: int = 7) -> logging.LogRecord:
    return logging.LogRecord("armbridge.arm", logging.WARNING, "arm.py", line, "hot", (), None)


def test_the_next_line_has_the_number_of_suppressed_ones() -> None:
    now_s = [0.0]
    flood = FloodFilter(lambda: now_s[0])
    for _ in range(BURST + 3):
        flood.filter(record())
    now_s[0] = 1.0 / LINES_PER_S
    after = record()
    assert flood.filter(after)
    line = logs.PlainFormatter().format(after)
    assert line.endswith("hot (3 more lines like this were left out before)")
    assert logs.PlainFormatter().format(record()).endswith("hot")


def test_every_process_logs_through_it() -> None:
    root = logging.getLogger()
    former, root.handlers = root.handlers, []
    try:
        logs.configure("INFO", "plain")
        assert [type(each) for each in root.handlers[0].filters] == [FloodFilter]
    finally:
        root.handlers = former
