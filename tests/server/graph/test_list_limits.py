"""Limits of the lists in requests, goals and messages to the server."""

from typing import Any

import pytest

from protocol.errors import MessageError
from server.graph.actions import Result
from server.graph.list_limits import MAX_VALUES, ListLimits
from server.graph.message_types import MessageTypes, ReceivedMessage
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

SEQUENCE = "moveit_msgs/srv/GetMotionSequence"
ITEMS = "moveit_msgs/msg/MotionSequenceRequest.items"
SERVER, CLIENT = Node("server"), Node("client", remote=True)


class CountingTypes(MessageTypes):
    """Counts the messages that are completed."""

    completed = 0

    def complete(self, *arguments: Any, **keywords: Any) -> dict[str, Any]:
        self.completed += 1
        return super().complete(*arguments, **keywords)


def refusal(limits: ListLimits, message: object, type_name: str = f"{SEQUENCE}_Request") -> str:
    """The sentence that refuses a message; empty for none."""
    try:
        limits.check(REGISTRY, type_name)(message)
    except MessageError as error:
        return str(error)
    return ""


BLENDED = {"req": {"path_constraints": {"joint_constraints": [{}] * 2}}}
CONSTRAINTS = ListLimits({"moveit_msgs/msg/Constraints.joint_constraints": 3})
FIELD = "request.items[].req.path_constraints.joint_constraints"
ITEM_VALUES = 43


def test_a_list_beyond_its_limit_is_refused_with_field_limit_and_value() -> None:
    for limits, item, most, sentence in (
        (ListLimits({ITEMS: 2}), {}, 2, "field request.items: wanted at most 2 elements in all, got 3"),
        # A limit is for all lists of the field together, and others count by the values that they stand for.
        (CONSTRAINTS, BLENDED, 1, f"field {FIELD}: wanted at most 3 elements in all, got 4"),
        (
            ListLimits(max_values=10 * ITEM_VALUES),
            {},
            10,
            "field request.items: wanted at most 430 values in all lists, as they are complete, got more",
        ),
    ):
        assert refusal(limits, {"request": {"items": [item] * most}}) == ""
        assert refusal(limits, {"request": {"items": [item] * (most + 1)}}) == sentence
        # In order of declaration, fields count as well.
        assert "request.items" in refusal(limits, [{"items": [item] * (most + 1)}])


@pytest.mark.parametrize("count", [MAX_VALUES, MAX_VALUES + 1])
def test_numbers_and_texts_count_as_values(count: int) -> None:
    refused = refusal(ListLimits(), {"fk_link_names": ["a"] * count}, "moveit_msgs/srv/GetPositionFK_Request")
    assert bool(refused) == (count > MAX_VALUES)


def test_what_does_not_fit_its_type_is_left_to_the_completion_and_a_message_counted_once() -> None:
    for message in (None, 3, "a", {"request": 3}, {"request": {"items": {"a": 1}}}, {"other": [{}] * 9}):
        assert refusal(ListLimits({ITEMS: 2}), message) == ""
    check = ListLimits({ITEMS: 2}).check(REGISTRY, f"{SEQUENCE}_Request")
    fits, exceeds = (ReceivedMessage({"request": {"items": [{}] * count}}, 100) for count in (2, 3))
    check(fits)
    fits.value = None
    check(fits)
    with pytest.raises(MessageError):
        check(exceeds)


@pytest.fixture
def graph() -> Graph:
    made = Graph(REGISTRY)
    made.services._message_types = made.actions._message_types = made.message_types = CountingTypes(REGISTRY)
    return made


async def test_a_request_or_a_goal_with_too_long_a_list_is_refused_before_it_is_completed(graph: Graph) -> None:
    graph.services.offer(SERVER, "/plan", SEQUENCE, lambda _request: {}, limits=ListLimits({ITEMS: 2}))
    response = answered(graph, "/plan", CLIENT, request={"items": [{}] * 3})
    assert not response.ok
    assert response.values.startswith("Service /plan: field request.items: wanted at most 2 elements")
    # Without a word about it, there is a limit all the same.
    graph.services.offer(SERVER, "/other", SEQUENCE, lambda _request: {})
    assert not answered(graph, "/other", CLIENT, request={"items": [{}] * 5000}).ok
    assert graph.message_types.completed == 0
    type_name = "moveit_msgs/action/MoveGroupSequence"
    graph.actions.offer(SERVER, "/move", type_name, lambda _goal: None, ListLimits({ITEMS: 2}))
    results: list[Result] = []
    goal = graph.actions.send_goal(CLIENT, "/move", type_name, {"request": {"items": [{}] * 3}}, results.append)
    assert goal is None
    assert "at most 2 elements in all, got 3" in results[0].values
    assert graph.message_types.completed == 0


def test_a_message_with_too_long_a_list_is_refused_before_it_is_completed_and_its_subscriber_told(graph: Graph) -> None:
    type_name = "geometry_msgs/msg/PoseArray"
    refused: list[str] = []
    check = ListLimits({f"{type_name}.poses": 2}).check(REGISTRY, type_name)
    subscriber = Subscriber(lambda _published: None, lambda error: refused.append(str(error)), check_lists=check)
    graph.subscribe(SERVER, "/poses", type_name, subscriber)
    with pytest.raises(MessageError):
        graph.publish(CLIENT, "/poses", {"poses": [{}] * 3})
    assert refused == ["field poses: wanted at most 2 elements in all, got 3"]
    assert graph.message_types.completed == 0
