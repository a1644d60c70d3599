from __future__ import annotations

from robot.control.repeats import CALM_S, Repeats


def test_the_first_and_then_every_power_of_two_is_told() -> None:
    repeats = Repeats()
    assert [count for count in range(1, 70) if repeats.due(0.0)] == [1, 2, 4, 8, 16, 32, 64]


def test_what_happened_once_needs_no_note() -> None:
    repeats = Repeats()
    repeats.due(0.0)
    assert repeats.note == ""


def test_what_happened_again_is_told_with_its_count() -> None:
    repeats = Repeats()
    for _ in range(4):
        repeats.due(0.0)
    assert repeats.note == " (4 times so far)"


def test_what_was_not_told_is_counted_as_well() -> None:
    repeats = Repeats()
    for _ in range(3):
        repeats.due(0.0)
    assert repeats.count == 3


def test_what_has_been_calm_for_long_is_told_as_the_first_time() -> None:
    repeats = Repeats()
    for _ in range(3):
        repeats.due(0.0)
    assert repeats.due(CALM_S + 1.0)
    assert repeats.note == ""
