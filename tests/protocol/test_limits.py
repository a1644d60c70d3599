import dataclasses

import pytest

from protocol.limits import Limits


def test_a_client_that_stops_reading_costs_two_mebibytes_at_most():
    limits = Limits()
    assert limits.max_queued_topic_bytes + limits.max_queued_request_bytes + limits.max_queued_reply_bytes <= 2 * 2**20


def test_every_limit_is_above_zero_and_fixed_for_the_session():
    limits = Limits()
    assert all(value > 0 for value in dataclasses.asdict(limits).values())
    with pytest.raises(dataclasses.FrozenInstanceError):
        limits.max_message_bytes = 1
