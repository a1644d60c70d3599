from __future__ import annotations

from robot.control.watchdog import Watchdog


def test_silence_is_borne_up_to_its_limit() -> None:
    watchdog = Watchdog(0.5, 10.0)
    assert not watchdog.expired(10.5)
    assert watchdog.expired(10.51)
    assert watchdog.silence_s(10.51) > 0.5


def test_any_message_ends_the_silence() -> None:
    watchdog = Watchdog(0.5, 10.0)
    watchdog.hear(11.0)
    assert not watchdog.expired(11.4)
