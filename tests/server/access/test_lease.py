from __future__ import annotations

import pytest

from server.access.lease import RESERVED_S, Lease
from server.access.roles import Identity, Role
from server.graph.node import Node


class World:
    def __init__(self, policy: str = "lease") -> None:
        self.busy = False
        self.changes: list[str] = []
        self.lease = Lease(policy, 10.0, lambda: 1_000_000.0)  # type: ignore[arg-type]
        self.lease.busy = lambda: self.busy
        self.lease.on_change = lambda: self.changes.append(str(self.lease.holder))
        self.a, self.b = Node("a", remote=True), Node("b", remote=True)


@pytest.fixture
def world() -> World:
    return World()


def test_the_first_who_drives_controls_the_arm(world: World) -> None:
    assert world.lease.drive(world.a, 0.0) is None
    assert world.lease.holder is world.a
    assert world.changes == ["a"]


def test_another_is_told_who_drives_since_when_and_how_it_gets_free(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    refusal = world.lease.drive(world.b, 1.0)
    assert refusal == (
        "a has controlled the arm since 13:46:40 UTC; it is free when that client leaves, calls "
        "/arm/release_control, or asks for nothing for another 9 s (access.control_idle_s = 10)"
    )
    assert world.lease.holder is world.a


def test_it_is_free_when_its_holder_leaves(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.lease.leave(world.a)
    assert world.lease.drive(world.b, 0.0) is None


def test_one_who_leaves_without_it_changes_nothing(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.lease.leave(world.b)
    assert world.lease.holder is world.a


def test_it_is_free_when_its_holder_releases_it(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    assert world.lease.release(world.a, 0.0) is None
    assert world.lease.drive(world.b, 0.0) is None


def test_who_asks_for_nothing_for_too_long_loses_it(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.lease.drive(world.a, 5.0)
    assert world.lease.drive(world.b, 14.9) is not None
    assert world.lease.drive(world.b, 15.0) is None


def test_nobody_idles_while_a_goal_is_worked_on_nor_right_after(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.busy = True
    world.lease.tick(60.0)
    world.busy = False
    assert world.lease.drive(world.b, 69.9) is not None
    assert world.lease.drive(world.b, 70.0) is None


def test_the_beat_frees_it_even_if_nobody_asks(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.lease.tick(10.0)
    assert world.lease.holder is None
    assert world.changes == ["a", "None"]


@pytest.mark.parametrize(
    "thief", [Identity("", Role.ADMIN), Identity("otto", Role.OPERATE), Identity("screen", Role.VIEW), None]
)
def test_nobody_but_an_admin_by_token_takes_it_from_another(world: World, thief: Identity | None) -> None:
    world.lease.drive(world.a, 0.0)
    world.b.identity = thief
    assert "access.admin_tokens" in str(world.lease.release(world.b, 0.0))
    assert world.lease.holder is world.a


def test_an_admin_by_token_does(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.b.identity = Identity("ada", Role.ADMIN)
    assert world.lease.drive(world.b, 0.0) is not None
    assert world.lease.release(world.b, 0.0) is None
    assert world.lease.drive(world.b, 0.0) is None


def test_who_loses_it_to_an_admin_does_not_have_it_again_before_the_admin_could_take_it(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    world.b.identity = Identity("ada", Role.ADMIN)
    world.lease.release(world.b, 1.0)
    assert "b has taken control from another; it is free in 2 s" in str(world.lease.drive(world.a, 2.0))
    assert world.lease.drive(world.b, 2.5) is None
    world.lease.release(world.b, 2.6)
    assert world.lease.drive(world.a, 2.7) is None


@pytest.mark.parametrize("leaves", [True, False])
def test_an_admin_who_does_not_take_it_keeps_nobody_waiting(world: World, leaves: bool) -> None:
    world.lease.drive(world.a, 0.0)
    world.b.identity = Identity("ada", Role.ADMIN)
    world.lease.release(world.b, 1.0)
    if leaves:
        world.lease.leave(world.b)
    assert world.lease.drive(world.a, 1.5 if leaves else 1.0 + RESERVED_S) is None


def test_parts_of_the_server_are_not_asked(world: World) -> None:
    world.lease.drive(world.a, 0.0)
    assert world.lease.drive(Node("inside"), 0.0) is None
    assert world.lease.holder is world.a


def test_where_control_is_shared_all_drive() -> None:
    world = World("shared")
    assert world.lease.drive(world.a, 0.0) is None
    assert world.lease.drive(world.b, 0.0) is None
    assert world.lease.holder is None


def test_it_is_known_for_how_long_its_holder_has_asked_for_nothing(world: World) -> None:
    assert world.lease.idle_s(5.0) == 0.0
    world.lease.drive(world.a, 5.0)
    assert world.lease.idle_s(8.0) == 3.0
