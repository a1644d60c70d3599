from __future__ import annotations

import dataclasses

import pytest

from protocol.limits import Limits
from server.config_loader import load
from server.errors import ConfigurationError
from server.gateway.session_settings import SessionSettings


def test_every_limit_of_a_session_is_a_setting_with_its_default() -> None:
    assert SessionSettings().limits() == Limits()
    assert set(SessionSettings.model_fields) == {field.name for field in dataclasses.fields(Limits)}


def test_a_limit_that_is_set_is_the_session_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ARMBRIDGE_SERVER__LIMITS__MAX_SUBSCRIPTIONS", "7")
    assert load(None, {}).server.limits.limits() == Limits(max_subscriptions=7)


def test_a_limit_out_of_range_is_refused_with_its_key() -> None:
    with pytest.raises(ConfigurationError, match=r"server.limits.max_message_bytes: .*65536.*\(it is 10"):
        load(None, {"server": {"limits": {"max_message_bytes": 10}}})
