import json
from hashlib import sha512
from typing import Any

import pytest

from protocol.codecs import png
from server.access.authentication import MAX_WRONG
from server.access.settings import AccessSettings
from server.gateway.client import MAX_FIRST_BYTES
from server.graph.permissions import Identity, Role
from tests.helpers.gateway import InProcess

ADA, SCREEN = "ada-0123456789abcdef", "screen-0123456789abcdef"
SETTINGS = AccessSettings.model_validate({"admin_tokens": {"ada": ADA}, "view_tokens": {"screen": SCREEN}})


@pytest.fixture
def world() -> InProcess:
    """A server with tokens, and a client that has shown none."""
    world = InProcess(access=SETTINGS)
    world.enter("x", None)
    return world


def mac(token: str, now_s: float, rand: str = "r") -> dict[str, Any]:
    """The fields that roslibjs sends by ``ros.authenticate``."""
    t, end = int(now_s), int(now_s) + 100
    text = f"{token}client-addressdest-address{rand}{t}user{end}"
    fields = {"client": "client-address", "dest": "dest-address", "rand": rand, "t": t, "level": "user", "end": end}
    return {"op": "auth", "mac": sha512(text.encode()).hexdigest(), **fields}


def identity(world: InProcess, name: str = "x") -> Identity | None:
    return world.client(name).node.identity


def test_a_token_identifies_a_client(world: InProcess) -> None:
    world.client("x").node.address = "10.0.0.1:5"
    world.say("x", op="auth", token=SCREEN)
    assert identity(world) == Identity("screen", Role.VIEW)
    assert world.client("x").node.name == "screen (10.0.0.1:5)"
    assert not world.closed


def test_operations_after_auth_in_the_same_frame_are_carried_out(world: InProcess) -> None:
    frame = json.dumps({"op": "auth", "token": ADA}) + json.dumps(
        {"op": "subscribe", "topic": "/a", "type": "std_msgs/String"}
    )
    world.client("x").receive_frame(frame)
    assert "/a" in world.graph.topic_names.types()


WRONG = {
    "a token that is nobody's": {"op": "auth", "token": "guess-0123456789abcdef"},
    "no token": {"op": "auth"},
    "a proof of another token": mac("guess-0123456789abcdef", 0.0),
}


@pytest.mark.parametrize("operation", WRONG.values(), ids=WRONG.keys())
def test_a_wrong_auth_ends_the_connection_with_a_reason(world: InProcess, operation: dict[str, Any]) -> None:
    world.say("x", **operation)
    assert world.closed["x"].startswith("auth: ")
    assert identity(world) is None


PICTURE = png.encode(b'{"op":"subscribe","topic":"/a","type":"std_msgs/String"}')

FRAMES = {
    "a subscription": '{"op":"subscribe","topic":"/joint_states"}',
    "a stop": '{"op":"publish","topic":"/stop"}',
    "a level": '{"op":"set_level","level":"info"}',
    "a picture": json.dumps({"op": "png", "data": PICTURE}),
    "no operation": '{"op":"authx"}',
    "no JSON": "auth",
    "nothing": "",
    "half an object": '{"op":"auth","token":',
    "a fragment": '{"op":"fragment","id":"1","num":0,"total":2,"data":"{"}',
    "a late auth": '{"op":"subscribe","topic":"/a","type":"std_msgs/String"}'
    + json.dumps({"op": "auth", "token": ADA}),
    "more than an auth has": json.dumps({"op": "auth", "token": ADA, "more": "x" * MAX_FIRST_BYTES}),
}


@pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES.keys())
def test_whatever_else_comes_first_ends_the_connection_and_does_nothing(world: InProcess, frame: str) -> None:
    world.client("x").receive_frame(frame)
    assert world.closed["x"]
    assert identity(world) is None
    assert world.graph.topic_names.types() == {}


def test_there_is_one_guess_a_connection(world: InProcess) -> None:
    guess = json.dumps({"op": "auth", "token": "guess-0123456789abcdef"})
    world.client("x").receive_frame(guess + json.dumps({"op": "auth", "token": ADA}))
    assert identity(world) is None
    world.say("x", op="auth", token=ADA)
    assert identity(world) is None


def test_a_proof_that_somebody_has_overheard_is_good_for_nothing(world: InProcess) -> None:
    overheard = mac(ADA, world.clock())
    world.say("x", **overheard)
    assert identity(world) == Identity("ada", Role.ADMIN)
    world.enter("thief", None)
    world.say("thief", **overheard)
    assert "used before" in world.closed["thief"]
    assert identity(world, "thief") is None


def test_a_client_raises_its_rights_by_a_right_token(world: InProcess) -> None:
    world.say("x", op="auth", token=SCREEN)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert world.graph.topic_names.types() == {}
    world.say("x", op="auth", token=ADA)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert "/a" in world.graph.topic_names.types()


def test_a_wrong_token_costs_a_client_the_rights_that_it_had(world: InProcess) -> None:
    world.say("x", op="auth", token=SCREEN)
    world.say("x", op="auth", token="guess-0123456789abcdef")
    assert world.closed["x"]
    world.say("x", op="subscribe", topic="/a", type="std_msgs/String")
    assert world.graph.topic_names.types() == {}


@pytest.mark.parametrize("fields", [{"role": "admin"}, {"level": "admin"}, {"identity": {"role": 3}}])
def test_nobody_gives_itself_a_role(world: InProcess, fields: dict[str, Any]) -> None:
    world.say("x", op="auth", token=SCREEN, **fields)
    assert identity(world) == Identity("screen", Role.VIEW)


def test_without_tokens_auth_changes_nothing() -> None:
    world = InProcess()
    world.say("x", op="set_level", level="info")
    world.say("x", op="auth", token="anything")
    assert identity(world) == Identity("", Role.ADMIN)
    assert "this server has no tokens; nothing changes" in world.heard("x")[-1]["msg"]
    assert not world.closed


def test_no_token_gets_into_the_log(world: InProcess, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG")
    guess = "guess-0123456789abcdef"
    world.say("x", op="auth", token=ADA)
    world.say("x", op="auth", token=[guess])
    world.say("x", op="auth", token=guess)
    assert caplog.text
    assert ADA not in caplog.text
    assert guess not in caplog.text


@pytest.mark.parametrize("frame", ['"%s"', '{"op":"%s"}', "%s", '{"op":"auth","token":["%s"]}'])
def test_nor_does_one_shown_in_a_wrong_way(world: InProcess, frame: str, caplog: pytest.LogCaptureFixture) -> None:
    world.client("x").receive_frame(frame.replace("%s", ADA))
    assert world.closed["x"]
    assert ADA not in caplog.text + world.closed["x"]


@pytest.mark.parametrize(("token", "left"), [("guess-0123456789abcdef", False), (ADA, True)])
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
