"""The scenes that the benchmark of planning draws at random."""

from __future__ import annotations

import pytest

from benchmarks.planning_random import arrangement


def test_the_same_seed_and_number_draw_the_same_things() -> None:
    assert arrangement(1, 0) == arrangement(1, 0)


def test_other_seeds_and_numbers_draw_other_things() -> None:
    drawn = [arrangement(seed, number).objects for seed in (1, 2) for number in (0, 1)]
    assert all(first != second for i, first in enumerate(drawn) for second in drawn[:i])


@pytest.mark.parametrize("number", range(10))
def test_things_have_names_of_their_own_and_sizes(number: int) -> None:
    objects = arrangement(1, number).objects
    names = [each["id"] for each in objects]
    assert len(set(names)) == len(names) >= 3
    assert all(size > 0.0 for each in objects for size in each["dimensions"])


@pytest.mark.parametrize("number", range(10))
def test_the_difficult_region_has_an_extent_above_the_table(number: int) -> None:
    lower, upper = arrangement(1, number).region
    assert lower[2] > 0.0
    assert all(low < high for low, high in zip(lower, upper, strict=True))
