from __future__ import annotations

import pytest

from server.moveit.servo.servo_node import SILENCE_S, CommandType, Gate
from server.node import Node

TIMEOUT_S = 0.25
ONE, OTHER = Node("one"), Node("other")
TWIST, JOG = CommandType.TWIST, CommandType.JOINT_JOG


class Rig:
    """A gate, and why the arm is busy."""

    def __init__(self) -> None:
        self.busy = ""
        self.gate = Gate(lambda _client: True, TIMEOUT_S, lambda: self.busy)

    def said(self, at_s: float, client: Node = ONE, kind: CommandType = TWIST) -> str:
        refusal = self.gate.refusal(client, kind, at_s)
        return "" if refusal is None else refusal.message


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_the_first_command_needs_no_permission_and_the_kind_may_change(rig: Rig) -> None:
    assert rig.said(0.0) == ""
    assert rig.said(0.1, kind=JOG) == ""


def test_a_second_client_is_turned_away_by_the_name_of_the_first(rig: Rig) -> None:
    rig.said(0.0)
    refusal = rig.gate.refusal(OTHER, TWIST, 0.1)
    assert refusal is not None
    assert "one does" in refusal.message
    assert not refusal.of_owner


def test_a_selected_kind_excludes_the_others_until_the_stick_is_let_go_of(rig: Rig) -> None:
    rig.gate.select(TWIST)
    assert rig.said(0.0) == ""
    assert "TWIST was selected" in rig.said(0.1, kind=JOG)
    assert rig.said(0.2 + SILENCE_S, OTHER, JOG) == ""


def test_a_pause_lets_nothing_through(rig: Rig) -> None:
    rig.gate.paused = True
    assert "paused" in rig.said(0.0)
    rig.gate.paused = False
    assert rig.said(0.1) == ""


def test_after_an_interruption_a_stick_that_is_still_held_does_not_go_on(rig: Rig) -> None:
    rig.said(0.0)
    rig.gate.interrupt("stopped by /arm/stop")
    for step in range(1, 20):
        assert "stopped by /arm/stop" in rig.said(0.1 * step)
    assert rig.said(1.9 + 1.1 * TIMEOUT_S) == ""


def test_an_interruption_can_be_reset(rig: Rig) -> None:
    rig.said(0.0)
    rig.gate.interrupt("stopped")
    rig.gate.reset()
    assert rig.said(0.1) == ""


def test_a_busy_arm_is_told(rig: Rig) -> None:
    rig.busy = "goal 7 is worked on"
    assert rig.said(0.0) == "goal 7 is worked on"
