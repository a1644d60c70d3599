from __future__ import annotations

import pytest

from server.recording.qos import KEY, channel_metadata, is_latched


@pytest.mark.parametrize("latched", [True, False])
def test_whether_a_topic_is_latched_is_read_back(latched: bool) -> None:
    assert is_latched(channel_metadata(latched)) is latched


@pytest.mark.parametrize(("number", "latched"), [(1, True), (2, False)])
def test_the_numbers_of_older_releases_are_understood(number: int, latched: bool) -> None:
    assert is_latched({KEY: f"- history: 1\n  depth: 10\n  durability: {number}\n"}) is latched


def test_a_channel_without_profiles_is_not_latched() -> None:
    assert not is_latched({})
