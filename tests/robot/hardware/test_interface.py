from __future__ import annotations

import pytest

from robot.hardware.interface import run_to_end


def test_a_sequence_is_run_to_its_result_and_waited_for_as_it_asks():
    def steps():
        yield 0.5
        yield 0.0
        return "done"

    waited = []
    assert run_to_end(steps(), waited.append) == "done"
    assert waited == [0.5, 0.0]


def test_what_a_sequence_raises_is_raised():
    def steps():
        yield 0.0
        raise LookupError

    with pytest.raises(LookupError):
        run_to_end(steps(), lambda _wait_s: None)
