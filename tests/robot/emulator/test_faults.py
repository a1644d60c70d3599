from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.feetech import FEETECH
from robot.emulator.servo_bus import Faults
from robot.hardware.feetech.bus import parse_status_frames

ID = 1
SENT = FEETECH.status_packet(ID, 0, bytes(15))
OF_REPLIES = ["drop", "corrupt", "wrong_id", "truncate", "duplicate", "noise"]


def faults(seed=5, **probabilities):
    return Faults(**probabilities, random=random.Random(seed))


def arrived(chance):
    return chance.apply(FEETECH.status_packet(chance.id_of_reply(ID), 0, bytes(15)))


@pytest.mark.parametrize("name", OF_REPLIES)
def test_a_reply_is_struck_as_often_as_asked_and_alike_for_a_seed(name):
    def arrivals():
        chance = faults(**{name: 0.3})
        return [arrived(chance) for _ in range(1000)]

    assert sum(each == SENT for each in arrivals()) == pytest.approx(700, abs=60)
    assert arrivals() == arrivals()


def test_without_faults_every_reply_arrives_as_it_was_sent():
    assert arrived(faults()) == SENT
    assert not faults().loses_instruction()
    assert faults().hold_up_s() == 0.0


@given(st.integers(0, 2**32), st.sampled_from(["drop", "corrupt", "wrong_id", "truncate"]))
def test_a_reply_that_is_struck_is_never_taken_for_a_good_one(seed, name):
    assert parse_status_frames(arrived(faults(seed, **{name: 1.0})), [ID], 15) == {}


def test_a_doubled_reply_comes_twice_and_a_noisy_one_ends_as_it_was_sent():
    assert arrived(faults(duplicate=1.0)) == SENT * 2
    noisy = arrived(faults(noise=1.0))
    assert noisy.endswith(SENT)
    assert len(noisy) > len(SENT)
