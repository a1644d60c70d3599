from __future__ import annotations

import pytest

from server.access.roles import ANYONE, Identity, Role
from server.access.tokens import Tokens
from server.errors import ConfigurationError
from server.gateway.entrance.exposure import check_exposure

OPEN = Tokens({}, ANYONE)
LOCKED = Tokens({"correct-horse-battery": Identity("admin", Role.ADMIN)}, None)
EVERYWHERE = ["0.0.0.0"]


@pytest.mark.parametrize("addresses", [["127.0.0.1"], ["127.0.0.1", "::1"], ["127.1.2.3"]])
def test_what_only_this_machine_reaches_needs_nothing(addresses: list[str], caplog: pytest.LogCaptureFixture) -> None:
    check_exposure("localhost", addresses, OPEN, insecure=False)
    assert not caplog.records


@pytest.mark.parametrize("addresses", [EVERYWHERE, ["::"], ["192.168.0.2"], ["127.0.0.1", "192.168.0.2"], ["fe80::1"]])
def test_what_others_reach_needs_a_token_or_the_word(addresses: list[str]) -> None:
    with pytest.raises(ConfigurationError) as refused:
        check_exposure("robot", addresses, OPEN, insecure=False)
    assert "ARMBRIDGE_ACCESS__TOKEN" in str(refused.value)
    assert "--insecure" in str(refused.value)
    assert addresses[-1] in str(refused.value)


def test_with_tokens_it_is_served_without_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    check_exposure("0.0.0.0", EVERYWHERE, LOCKED, insecure=False)
    assert not caplog.records


def test_what_was_said_to_be_open_is_warned_of_at_each_start(caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(2):
        check_exposure("0.0.0.0", EVERYWHERE, OPEN, insecure=True)
    assert caplog.text.count("INSECURE: whoever reaches 0.0.0.0 may connect without a token as admin") == 2


def test_who_may_move_the_arm_without_a_token_needs_the_word_and_who_may_look_does_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    token = {"correct-horse-battery": Identity("admin", Role.ADMIN)}
    check_exposure("robot", EVERYWHERE, Tokens(token, Identity("", Role.VIEW)), insecure=False)
    assert not caplog.records
    moving = Tokens(token, Identity("", Role.OPERATE))
    check_exposure("robot", EVERYWHERE, moving, insecure=True)
    assert "as operate" in caplog.text
    with pytest.raises(ConfigurationError, match=r"access\.without_token: .* set it to view or none"):
        check_exposure("robot", EVERYWHERE, moving, insecure=False)
