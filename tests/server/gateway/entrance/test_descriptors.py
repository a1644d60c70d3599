from __future__ import annotations

import resource

import pytest

from server.gateway.entrance.descriptors import SPARE, make_room_for


class Limit:
    """The limit of open files, without changing that of the tests."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, soft: int, hard: int) -> None:
        self.value = soft, hard
        monkeypatch.setattr(resource, "getrlimit", lambda _which: self.value)
        monkeypatch.setattr(resource, "setrlimit", self._set)

    def _set(self, which: int, value: tuple[int, int]) -> None:
        assert which == resource.RLIMIT_NOFILE
        self.value = value


@pytest.mark.parametrize("hard", [4096, resource.RLIM_INFINITY])
def test_the_limit_is_raised_as_far_as_is_needed(
    monkeypatch: pytest.MonkeyPatch, hard: int, caplog: pytest.LogCaptureFixture
) -> None:
    limit = Limit(monkeypatch, 1024, hard)
    make_room_for(1000)
    assert limit.value == (1000 + SPARE, hard)
    assert not caplog.records


@pytest.mark.parametrize("soft", [1024, resource.RLIM_INFINITY])
def test_a_limit_that_is_high_enough_stays(monkeypatch: pytest.MonkeyPatch, soft: int) -> None:
    limit = Limit(monkeypatch, soft, 4096)
    make_room_for(100)
    assert limit.value == (soft, 4096)


def test_one_that_cannot_be_raised_enough_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    limit = Limit(monkeypatch, 1024, 2048)
    make_room_for(5000)
    assert limit.value == (2048, 2048)
    assert f"enough for {2048 - SPARE} clients, not for server.max_clients = 5000" in caplog.text
