from __future__ import annotations

import logging

import pytest

from server.gateway.log_share import BURST, LINES_PER_S, LogShare


def test_a_flood_of_lines_is_cut_short_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    share = LogShare()
    for number in range(BURST + 30):
        share.write(100.0, logging.WARNING, f"client x: refused: {number}")
    assert [record.getMessage() for record in caplog.records] == [
        f"client x: refused: {number}" for number in range(BURST)
    ]
    share.write(100.0 + 1.0 / LINES_PER_S, logging.WARNING, "client x: refused: later")
    assert caplog.records[-1].getMessage() == (
        "client x: refused: later (30 more lines about this client were left out before)"
    )


def test_lines_now_and_then_are_all_written(caplog: pytest.LogCaptureFixture) -> None:
    share = LogShare()
    for number in range(3 * BURST):
        share.write(float(number), logging.ERROR, "client x: refused: no")
    assert len(caplog.records) == 3 * BURST
    assert {record.levelno for record in caplog.records} == {logging.ERROR}
