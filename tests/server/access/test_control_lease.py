import json
from importlib import metadata
from typing import Any

import pytest

from harness.clients import values_of
from server.access.authorization import Access
from server.access.control_lease import RESERVED_S, ControlLease, ControlServices
from server.access.settings import AccessSettings
from server.execution.queue import RunningGoal
from server.graph.permissions import Identity, Node, Role
from server.graph.topics import LocalGraph
from tests.helpers.gateway import InProcess

GOAL = RunningGoal("goal 5 of a from /execute_trajectory", 33.2)


class Leased:
    def __init__(self, policy: str = "lease") -> None:
        self.busy: RunningGoal | None = None
        self.changes: list[str] = []
        self.lease = ControlLease(policy, 10.0, lambda: 1_000_000.0, lambda: self.busy)  # type: ignore[arg-type]
        self.lease.watchers.append(lambda: self.changes.append(str(self.lease.holder)))
        self.a, self.b = Node("a", remote=True), Node("b", remote=True)


@pytest.fixture
def leased() -> Leased:
    """An arm that ``a`` drives since 0 s."""
    made = Leased()
    made.lease.drive(made.a, 0.0)
    return made


def test_another_client_is_told_the_holder_the_time_and_how_control_becomes_free(leased: Leased) -> None:
    assert leased.lease.drive(leased.b, 1.0) == (
        "a has controlled the arm since 13:46:40 UTC; it is free when that client leaves, calls "
        "/arm/release_control, or asks for nothing for another 9 s (access.control_idle_s = 10)"
    )
    # Parts of the server are not asked.
    assert leased.lease.drive(Node("inside"), 0.0) is None
    assert leased.lease.holder is leased.a


def test_answers_name_the_arm_and_are_true_for_the_next_client() -> None:
    access = Access(
        AccessSettings(), wall_clock=lambda: 1_000_000.0, arms={"left": lambda: None, "right": lambda: None}
    )
    whole, left, right = access.lease, access.leases_of_arms["left"], access.leases_of_arms["right"]
    told: list[str] = []
    left.watchers.append(lambda: told.append(left.sentence()))
    a, b = Node("a", remote=True), Node("b", remote=True, identity=Identity("boss", Role.ADMIN))
    assert left.drive(a, 0.0) is None
    assert left.sentence() == whole.sentence() == "a controls the arm left"
    assert right.sentence() == "nobody controls the arm right; the first who moves it does"
    for lease in (left, whole):
        assert "calls /left/arm/release_control, or" in (lease.drive(b, 1.0) or "")
    left.release(a, 2.0)
    assert whole.sentence() == "nobody controls all arms; the first who moves them does"
    assert whole.drive(a, 3.0) is None
    # The control of the left arm was not held, and is not free.
    assert left.release(b, 4.0) is None
    assert left.sentence() == right.sentence() == "a controls all arms"
    whole.release(b, 5.0)
    assert whole.sentence() == f"nobody controls all arms; for {RESERVED_S:g} s only b may take it"
    whole.tick(5.0 + RESERVED_S)
    free = "nobody controls the arm left; the first who moves it does"
    assert told == ["a controls the arm left", free, "a controls all arms", free, free]


def test_another_is_told_of_the_goal_that_runs_and_of_those_behind_it(leased: Leased) -> None:
    leased.busy = GOAL
    assert leased.lease.drive(leased.b, 20.0) == (
        "a has controlled the arm since 13:46:40 UTC, and goal 5 of a from /execute_trajectory runs until about "
        "13:47:13 UTC, in 34 s; it is free when that client leaves, calls /arm/release_control, or has asked for "
        "nothing for 10 s after the last goal (access.control_idle_s = 10)"
    )
    leased.busy = RunningGoal("goal 5 of a from /move_action", None, 2)
    assert (
        "goal 5 of a from /move_action is worked on, whose motion has not begun, and 2 more wait behind it; it is free"
    ) in str(leased.lease.drive(leased.b, 20.0))


def test_an_idle_holder_loses_control_also_of_one_arm_and_nobody_idles_while_a_goal_is_worked_on(
    leased: Leased,
) -> None:
    leased.lease.drive(leased.a, 5.0)
    leased.busy = GOAL
    leased.lease.tick(60.0)
    leased.busy = None
    several = Access(AccessSettings(control_idle_s=10.0), arms={"left": lambda: None, "right": lambda: None})
    several.leases_of_arms["left"].drive(leased.a, 60.0)
    for lease in (leased.lease, several.lease):
        assert lease.drive(leased.b, 69.9) is not None
        assert lease.drive(leased.b, 70.0) is None


def test_nobody_but_an_admin_by_token_takes_it_from_another(leased: Leased) -> None:
    otto, screen = Identity("otto", Role.OPERATE), Identity("screen", Role.VIEW)
    for thief in (Identity("", Role.ADMIN), otto, screen, None):
        leased.b.identity = thief
        assert "access.admin_tokens" in str(leased.lease.release(leased.b, 0.0)), thief
        assert leased.lease.holder is leased.a, thief


def test_after_an_admin_released_control_its_former_holder_waits(leased: Leased) -> None:
    leased.b.identity = Identity("ada", Role.ADMIN)
    leased.lease.release(leased.b, 1.0)
    assert "b has taken control from another; it is free in 1 s" in str(leased.lease.drive(leased.a, 3.5))
    assert leased.lease.drive(leased.b, 3.6) is None
    leased.lease.release(leased.b, 3.7)
    assert leased.lease.drive(leased.a, 3.8) is None


@pytest.mark.parametrize("leaves", [True, False])
def test_an_admin_that_does_not_take_control_keeps_nobody_waiting(leased: Leased, leaves: bool) -> None:
    leased.b.identity = Identity("ada", Role.ADMIN)
    leased.lease.release(leased.b, 1.0)
    if leaves:
        leased.lease.leave(leased.b)
    assert leased.lease.drive(leased.a, 1.5 if leaves else 1.0 + RESERVED_S) is None


class World(InProcess):
    """Clients that may drive an arm."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(access=AccessSettings.model_validate(settings))
        self.control = ControlServices(LocalGraph(self.graph), self.access.lease)

    def call(self, client: str, service: str) -> Any:
        self.say(client, op="call_service", service=service, id="asked")
        (answer,) = (heard for heard in self.heard(client) if heard.get("id") == "asked")
        return answer["values"]

    def watch(self, client: str) -> None:
        self.say(client, op="subscribe", topic="/arm/control")

    def told(self, client: str) -> list[dict[str, Any]]:
        return [heard["msg"] for heard in self.heard(client) if heard["op"] == "publish"]


@pytest.fixture
def world() -> World:
    return World()


async def test_subscribers_are_told_at_once_who_has_control_since_when_and_when_it_is_free(world: World) -> None:
    world.client("a").node.address = "10.0.0.1:5"
    world.watch("late")
    (status,) = world.told("late")
    sentence = "nobody controls the arm; the first who moves it does"
    assert (status["name"], status["hardware_id"], status["message"]) == ("control", "", sentence)
    told = {"holder": "", "address": "", "policy": "lease", "since": "", "idle_s": "0", "free_in_s": ""}
    assert values_of(status) == told
    assert world.call("a", "/arm/take_control") == {"success": True, "message": "a controls the arm"}
    (status,) = world.told("late")
    assert (status["hardware_id"], status["message"]) == ("a", "a controls the arm")
    taken = {"holder": "a", "address": "10.0.0.1:5", "policy": "lease", "idle_s": "0", "free_in_s": "10"}
    values = values_of(status)
    assert float(values.pop("since")) > 0.0
    assert values == taken
    await world.close("a")
    assert values_of(world.told("late")[-1]) == told


async def test_each_second_tells_the_idle_time_of_a_holder_until_control_is_free(world: World) -> None:
    world.busy = GOAL
    world.call("a", "/arm/take_control")
    world.watch("viewer")
    assert values_of(world.told("viewer")[-1])["free_in_s"] == "43"
    world.busy = None
    for _ in range(12):
        await world.advance(1.0)
    idled = [values_of(status) for status in world.told("viewer")]
    assert [values["idle_s"] for values in idled] == [*map(str, range(1, 10)), "0"]
    assert [values["holder"] for values in idled] == ["a"] * 9 + [""]
    world.call("a", "/arm/take_control")
    world.told("viewer")
    world.control.close()
    await world.advance(5.0)
    assert world.told("viewer") == []


def test_with_shared_control_every_client_is_granted_it() -> None:
    world = World(control="shared")
    answer = {"success": True, "message": "all clients may drive the arm at once (access.control)"}
    assert [world.call(name, "/arm/take_control") for name in ("a", "b")] == [answer] * 2


def test_a_client_is_told_what_it_is_called_and_what_it_may_do(world: World) -> None:
    world.client("a").node.address = "10.0.0.1:5"
    answered = world.call("a", "/arm/who_am_i")
    told = {"name": "a", "address": "10.0.0.1:5", "role": "admin", "version": metadata.version("armbridge")}
    assert json.loads(answered["message"]) == told
