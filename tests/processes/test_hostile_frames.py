"""Processor time of reading frames that are made to take long."""

import time

import pytest

from protocol.framing import FrameReader
from protocol.limits import Limits

OPENED = ["{", '{"a":', '"', '{"', '{"a\\"', '["",', '{"a":[', '{"":"\\\\', '{"\\']
CLOSED = ["{}", "[{},", "[{{}},", "{  ", "}", '{"a",}']


def seconds_for(text: str) -> float:
    """Processor time of reading a text inside of an object, the least of three [s]."""
    times_s = []
    for _ in range(3):
        reader = FrameReader(Limits())
        started_s = time.thread_time()
        reader.feed('{"a":')
        reader.feed(text)
        times_s.append(time.thread_time() - started_s)
    return min(times_s)


@pytest.mark.parametrize("unit", OPENED + CLOSED)
def test_hostile_frames_take_time_in_proportion_to_their_length(unit: str) -> None:
    short_s, long_s = (seconds_for(unit * (size // len(unit))) for size in (50_000, 800_000))
    # Sixteen times the length; a quadratic reader would take 256 times as long. The floor is the clock's noise, and
    # that only the longer one is decoded in pieces.
    assert long_s < 64 * max(short_s, 0.01)


def test_an_object_in_very_many_frames_takes_time_in_proportion_to_its_length() -> None:
    reader = FrameReader(Limits())
    started_s = time.thread_time()
    reader.feed('{"a":["')
    for _ in range(20_000):
        reader.feed('",{"b":1},"')
    # Reading it anew with each frame would look at two gigabytes.
    assert time.thread_time() - started_s < 5
