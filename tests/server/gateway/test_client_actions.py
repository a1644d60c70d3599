import pytest

from protocol.limits import Limits
from tests.helpers.gateway import InProcess

TYPE = "control_msgs/GripperCommand"


@pytest.fixture
def world() -> InProcess:
    made = InProcess(Limits.model_construct(max_offers=2, max_calls_in_flight=2, max_queued_bytes=10_000))
    made.say("p", op="advertise_action", action="/grip", type=TYPE)
    return made


def send_goal(world: InProcess, mark: object, **options: object) -> None:
    world.say("c", op="send_action_goal", action="/grip", action_type=TYPE, id=mark, **options)


def finish(world: InProcess, number: int) -> None:
    mark = f"action_goal:/grip:{number}"
    world.say("p", op="action_result", action="/grip", id=mark, values={}, status=4, result=True)


def test_goals_beyond_the_limit_fail_at_once_and_ended_ones_make_room(world: InProcess) -> None:
    for mark in range(3):
        send_goal(world, mark)
    (refused,) = world.heard("c")
    assert (refused["id"], refused["result"], refused["status"]) == (2, False, 0)
    finish(world, 1)
    send_goal(world, 3)
    assert [answer["id"] for answer in world.heard("c")] == [0]
    assert len(world.heard("p")) == 3


def test_feedback_to_a_slow_sender_is_dropped_and_its_result_is_not(world: InProcess) -> None:
    send_goal(world, "g", feedback=True)
    sender, provider = world.client("c"), world.client("p")
    for _ in range(1000):
        provider.receive_frame('{"op":"action_feedback","action":"/grip","id":"action_goal:/grip:1","values":{}}')
    assert sender.session.dropped > 0
    assert not sender.session.send_queue.overflowed
    finish(world, 1)
    assert world.heard("c")[-1]["op"] == "action_result"


def test_a_goal_without_an_id_is_cancelled_without_one_by_its_sender_alone(world: InProcess) -> None:
    world.say("c", op="send_action_goal", action="/grip", action_type=TYPE)
    world.say("c", op="cancel_action_goal", action="grip")
    assert [asked["op"] for asked in world.heard("p")] == ["send_action_goal", "cancel_action_goal"]
    world.say("c", op="send_action_goal", action="/grip", action_type=TYPE)
    world.client("c").leave()
    world.say("d", op="cancel_action_goal", action="/grip")
    assert [asked["op"] for asked in world.heard("p")] == ["send_action_goal"]


def test_goals_that_a_provider_has_no_room_for_fail_and_the_provider_stays() -> None:
    world = InProcess(Limits.model_construct(max_queued_request_bytes=1000))
    world.say("p", op="advertise_action", action="/grip", type=TYPE)
    sender, provider = world.client("c"), world.client("p")
    goal = '{"op":"send_action_goal","action":"/grip","action_type":"control_msgs/GripperCommand"}'
    sender.receive_frame(goal * 5)
    assert not provider.session.send_queue.overflowed
    refused = world.heard("c")
    assert {(answer["status"], answer["result"]) for answer in refused} == {(0, False)}
    assert "does not read its goals" in refused[0]["values"]
    assert len(refused) + len(world.heard("p")) == 5
