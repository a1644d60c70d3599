import json

import pytest

from protocol.codecs import png
from server.access.authentication import MAX_WRONG
from server.access.settings import AccessSettings
from server.gateway.client import MAX_FIRST_BYTES
from server.graph.permissions import Identity, Role
from tests.helpers.gateway import InProcess

ADA, SCREEN, GUESS = (f"{name}-0123456789abcdef" for name in ("ada", "screen", "guess"))
LISTEN = {"op": "subscribe", "topic": "/a", "type": "std_msgs/String"}
SETTINGS = AccessSettings.model_validate({"admin_tokens": {"ada": ADA}, "view_tokens": {"screen": SCREEN}})


@pytest.fixture
def world() -> InProcess:
    """A server with tokens, and a client that has shown none."""
    world = InProcess(access=SETTINGS)
    world.enter("x", None)
    return world


def identity(world: InProcess, name: str = "x") -> Identity | None:
    return world.client(name).node.identity


def test_a_token_identifies_a_client_and_operations_after_it_are_carried_out(world: InProcess) -> None:
    world.client("x").node.address = "10.0.0.1:5"
    world.say("x", op="auth", token=SCREEN)
    assert identity(world) == Identity("screen", Role.VIEW)
    assert world.client("x").node.name == "screen (10.0.0.1:5)"
    assert not world.closed
    world.client("x").receive_frame(json.dumps({"op": "auth", "token": ADA}) + json.dumps(LISTEN))
    assert "/a" in world.graph.topic_names.types()


WRONG = {
    "a token that is nobody's": json.dumps({"op": "auth", "token": GUESS}),
    "no token": '{"op": "auth"}',
    "a proof of rosauth": '{"op": "auth", "mac": "0123", "rand": "r", "t": 0, "level": "admin", "end": 1}',
}
FRAMES = {
    "a subscription": '{"op":"subscribe","topic":"/joint_states"}',
    "a stop": '{"op":"publish","topic":"/stop"}',
    "a level": '{"op":"set_level","level":"info"}',
    "a picture": json.dumps({"op": "png", "data": png.encode(json.dumps(LISTEN).encode())}),
    "no operation": '{"op":"authx"}',
    "no JSON": "auth",
    "nothing": "",
    "half an object": '{"op":"auth","token":',
    "a fragment": '{"op":"fragment","id":"1","num":0,"total":2,"data":"{"}',
    "a late auth": json.dumps(LISTEN) + json.dumps({"op": "auth", "token": ADA}),
    "more than an auth has": json.dumps({"op": "auth", "token": ADA, "more": "x" * MAX_FIRST_BYTES}),
}


@pytest.mark.parametrize("what", [*WRONG, *FRAMES])
def test_anything_but_a_right_auth_at_first_ends_the_connection_and_does_nothing(world: InProcess, what: str) -> None:
    world.client("x").receive_frame({**WRONG, **FRAMES}[what])
    assert world.closed["x"].startswith("auth: " if what in WRONG else "")
    assert world.closed["x"]
    assert identity(world) is None
    assert world.graph.topic_names.types() == {}


def test_there_is_one_guess_a_connection(world: InProcess) -> None:
    world.client("x").receive_frame(WRONG["a token that is nobody's"] + json.dumps({"op": "auth", "token": ADA}))
    assert identity(world) is None
    world.say("x", op="auth", token=ADA)
    assert identity(world) is None


def test_a_client_has_the_rights_of_its_last_token_and_none_after_a_wrong_one(world: InProcess) -> None:
    world.say("x", op="auth", token=SCREEN)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert world.graph.topic_names.types() == {}
    world.say("x", op="auth", token=ADA)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert "/a" in world.graph.topic_names.types()
    world.say("x", op="auth", token=GUESS)
    assert world.closed["x"]
    world.say("x", op="subscribe", topic="/b", type="std_msgs/String")
    assert "/b" not in world.graph.topic_names.types()


def test_nobody_gives_itself_a_role(world: InProcess) -> None:
    for number, fields in enumerate(({"role": "admin"}, {"level": "admin"}, {"identity": {"role": 3}})):
        world.enter(f"y{number}", None)
        world.say(f"y{number}", op="auth", token=SCREEN, **fields)
        assert identity(world, f"y{number}") == Identity("screen", Role.VIEW), fields


def test_without_tokens_auth_changes_nothing() -> None:
    world = InProcess()
    world.say("x", op="set_level", level="info")
    world.say("x", op="auth", token="anything")
    assert identity(world) == Identity("", Role.ADMIN)
    assert "this server has no tokens; nothing changes" in world.heard("x")[-1]["msg"]
    assert not world.closed


def test_no_token_gets_into_the_log(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG")
    for token in (ADA, [GUESS], GUESS):
        world.say("x", op="auth", token=token)
    for number, frame in enumerate(('"%s"', '{"op":"%s"}', "%s", '{"op":"auth","token":["%s"]}')):
        world.enter(f"y{number}", None).receive_frame(frame.replace("%s", ADA))
        assert ADA not in world.closed[f"y{number}"]
    assert caplog.text
    assert ADA not in caplog.text
    assert GUESS not in caplog.text


@pytest.mark.parametrize(("token", "left"), [(GUESS, False), (ADA, True)])
def test_wrong_tokens_are_counted_and_right_ones_not(world: InProcess, token: str, left: bool) -> None:
    for number in range(MAX_WRONG - 1):
        world.throttle.record_failure("", number)
    world.say("x", op="auth", token=token)
    assert (world.throttle.refusal("") is None) is left


def test_from_an_address_with_too_many_wrong_ones_a_right_one_is_not_looked_at(world: InProcess) -> None:
    for number in range(MAX_WRONG):
        world.throttle.record_failure("", number)
    world.say("x", op="auth", token=ADA)
    assert "try again in" in world.closed["x"]
    assert identity(world) is None


def test_the_same_wrong_token_again_and_again_fills_no_log(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "armbridge.gateway")
    for _ in range(100):
        world.say("x", op="auth", token=SCREEN)
    assert caplog.text.count("with the role view") == 1
    world.say("x", op="auth", token=ADA)
    assert "with the role admin" in caplog.text
