from __future__ import annotations

from server.moveit.servo.servo_node import SILENCE_S, Ownership
from server.node import Node

ONE, OTHER = Node("one"), Node("other")


def test_who_takes_it_first_keeps_it_while_it_steers() -> None:
    ownership = Ownership(lambda _client: True)
    assert ownership.take(ONE, 0.0)
    assert not ownership.take(OTHER, 0.5)
    assert ownership.take(ONE, 0.9 * SILENCE_S)
    assert not ownership.take(OTHER, 1.8 * SILENCE_S)


def test_silence_sets_it_free() -> None:
    ownership = Ownership(lambda _client: True)
    ownership.take(ONE, 0.0)
    assert ownership.take(OTHER, 1.1 * SILENCE_S)
    assert ownership.owner(1.2 * SILENCE_S) is OTHER


def test_leaving_sets_it_free() -> None:
    present = {ONE, OTHER}
    ownership = Ownership(lambda client: client in present)
    ownership.take(ONE, 0.0)
    present.remove(ONE)
    assert ownership.owner(0.1) is None
    assert ownership.take(OTHER, 0.1)
