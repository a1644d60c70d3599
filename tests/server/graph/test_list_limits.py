"""Limits of the lists in requests, goals and messages to the server."""

import pytest

from protocol.errors import MessageError
from protocol.messages import BUDGET, MAX_READ_VALUES, ListLimits
from server.graph.actions import Result
from server.graph.message_types import BYTES_AT_ONCE, MessageTypes, PostponedError, ReceivedMessage
from server.graph.permissions import Node
from server.graph.topics import Graph, Subscriber
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

SEQUENCE = "moveit_msgs/srv/GetMotionSequence"
ITEMS = "moveit_msgs/msg/MotionSequenceRequest.items"
SERVER, CLIENT = Node("server"), Node("client", remote=True)


def refusal(limits: ListLimits, message: object, type_name: str = f"{SEQUENCE}_Request") -> str:
    """The sentence that refuses a message; empty for none."""
    try:
        MessageTypes(REGISTRY).complete_arguments(type_name, message, limits)
    except MessageError as error:
        return str(error)
    return ""


BLENDED = {"req": {"path_constraints": {"joint_constraints": [{}] * 2}}}
CONSTRAINTS = ListLimits({"moveit_msgs/msg/Constraints.joint_constraints": 3})
FIELD = "request.items[1].req.path_constraints.joint_constraints"
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


@pytest.mark.parametrize("count", [MAX_READ_VALUES, MAX_READ_VALUES + 1])
def test_numbers_and_texts_count_as_values(count: int) -> None:
    refused = refusal(ListLimits(), {"fk_link_names": ["a"] * count}, "moveit_msgs/srv/GetPositionFK_Request")
    assert bool(refused) == (count > MAX_READ_VALUES)


def test_the_elements_of_a_list_of_fixed_length_do_not_count() -> None:
    limits, triangle = ListLimits({"shape_msgs/msg/Mesh.triangles": 2}, max_values=2), {"vertex_indices": [0, 1, 2]}
    assert refusal(limits, {"triangles": [triangle] * 2}, "shape_msgs/msg/Mesh") == ""


def test_a_message_that_a_thread_completes_has_the_limits_of_its_reader() -> None:
    types, type_name, limits = MessageTypes(REGISTRY), f"{SEQUENCE}_Request", ListLimits({ITEMS: 2})
    message = ReceivedMessage({"request": {"items": [{}] * 3}}, BYTES_AT_ONCE + 1)
    with pytest.raises(PostponedError):
        types.complete_arguments(type_name, message, limits)
    message.complete(types, type_name)
    with pytest.raises(MessageError, match="at most 2 elements in all, got 3"):
        types.complete_arguments(type_name, message, limits)


@pytest.fixture
def graph() -> Graph:
    return Graph(REGISTRY)


async def test_a_request_or_a_goal_with_too_long_a_list_is_refused_before_it_is_completed(graph: Graph) -> None:
    graph.services.offer(SERVER, "/plan", SEQUENCE, lambda _request: {}, limits=ListLimits({ITEMS: 2}))
    response = answered(graph, "/plan", CLIENT, request={"items": [{}] * 3})
    assert not response.ok
    assert response.values.startswith("Service /plan: field request.items: wanted at most 2 elements")
    # Without a word about it, there is a limit all the same.
    graph.services.offer(SERVER, "/other", SEQUENCE, lambda _request: {})
    assert not answered(graph, "/other", CLIENT, request={"items": [{}] * 5000}).ok
    assert BUDGET.taken == 0
    type_name = "moveit_msgs/action/MoveGroupSequence"
    graph.actions.offer(SERVER, "/move", type_name, lambda _goal: None, ListLimits({ITEMS: 2}))
    results: list[Result] = []
    goal = graph.actions.send_goal(CLIENT, "/move", type_name, {"request": {"items": [{}] * 3}}, results.append)
    assert goal is None
    assert "at most 2 elements in all, got 3" in results[0].values
    assert BUDGET.taken == 0


def test_a_message_with_too_long_a_list_is_refused_before_it_is_completed_and_its_subscriber_told(graph: Graph) -> None:
    type_name = "geometry_msgs/msg/PoseArray"
    refused: list[str] = []
    limits = ListLimits({f"{type_name}.poses": 2})
    subscriber = Subscriber(lambda _published: None, lambda error: refused.append(str(error)), limits=limits)
    graph.subscribe(SERVER, "/poses", type_name, subscriber)
    with pytest.raises(MessageError):
        graph.publish(CLIENT, "/poses", {"poses": [{}] * 3})
    assert refused == ["field poses: wanted at most 2 elements in all, got 3"]
    assert BUDGET.taken == 0


def test_no_frame_is_read_by_itself_for_a_reader_with_limits(graph: Graph) -> None:
    graph.advertise(CLIENT, "/texts", "std_msgs/msg/String")
    assert graph.strict_reader(CLIENT, "/texts") is not None
    graph.subscribe(SERVER, "/texts", None, Subscriber(lambda _published: None, limits=ListLimits()))
    assert graph.strict_reader(CLIENT, "/texts") is None


def test_a_readers_limits_end_with_its_subscription(graph: Graph) -> None:
    limits = ListLimits({"geometry_msgs/msg/PoseArray.poses": 2})
    graph.subscribe(SERVER, "/poses", "geometry_msgs/msg/PoseArray", Subscriber(lambda _published: None, limits=limits))
    graph.subscribe(CLIENT, "/poses", None, Subscriber(lambda _published: None))
    graph.unsubscribe(SERVER, "/poses")
    graph.publish(CLIENT, "/poses", {"poses": [{}] * 3})
