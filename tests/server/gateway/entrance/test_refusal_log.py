from __future__ import annotations

import pytest

from server.gateway.entrance.refusal_log import MAX_TOLD, RefusalLog


def test_a_refusal_is_told_once_for_each_of_its_kind(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    for value in ("a", "b", "a", "a"):
        log.tell("origin", value, f"pages of {value}")
    log.tell("host", "a", "the name a")
    assert log.counts == {"origin": 4, "host": 1}
    assert [record.getMessage() for record in caplog.records] == [
        "refused: pages of a",
        "refused: pages of b",
        "refused: the name a",
    ]


def test_what_is_told_is_bounded_and_the_end_of_it_is_told(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    for number in range(2 * MAX_TOLD):
        log.tell("origin", str(number), "no")
    assert len(caplog.records) == MAX_TOLD + 1
    assert "further ones are not" in caplog.text
    assert len(log._told) == MAX_TOLD + 1


def test_nobody_writes_lines_of_their_own_or_fills_the_memory(caplog: pytest.LogCaptureFixture) -> None:
    log = RefusalLog()
    log.tell("origin", "x" * 100_000, "no\nINFO armbridge all is well")
    assert caplog.records[0].getMessage() == "refused: no\\nINFO armbridge all is well"
    assert max(len(value) for _, value in log._told) < 100
