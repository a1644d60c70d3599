"""The view of the graph below a prefix, by which one of several arms has the names of a single one."""

from dataclasses import replace
from typing import Any

from server.graph.actions import ActionGoal, GoalStatus, Result
from server.graph.permissions import GOAL, STOPPING, Node
from server.graph.topics import Graph, LocalGraph
from tests.helpers.graph import listen
from tests.helpers.messages import REGISTRY


def graph_with_left() -> tuple[Graph, LocalGraph]:
    graph = Graph(REGISTRY)
    return graph, LocalGraph(graph, "left")


def test_topics_stand_below_the_prefix_and_what_is_published_elsewhere_is_not_heard() -> None:
    graph, left = graph_with_left()
    part, taken = left.node("part"), list[Any]()
    part.advertise("/joint_states", "std_msgs/String", latch=True)
    heard = listen(graph, "/left/joint_states")
    part.publish("/joint_states", {"data": "here"})
    assert heard == [{"data": "here"}]
    assert (graph.topic_type("/joint_states"), part.publishers("/joint_states")) == (None, [part])
    assert len(part.subscribers("/joint_states")) == 1
    part.subscribe("/stop", "std_msgs/Empty", taken.append)
    for topic, count in (("/stop", 0), ("/left/stop", 1)):
        graph.advertise(Node("client"), topic, "std_msgs/Empty")
        graph.publish(Node("client"), topic, {})
        assert len(taken) == count


def test_rules_below_the_prefix_are_those_of_the_arm() -> None:
    graph, left = graph_with_left()
    part = left.node("part")
    part.offer("/arm/stop", "std_srvs/Trigger", lambda _request: {}, rule=STOPPING)
    part.offer_action("/wave", "example_interfaces/action/Fibonacci", lambda _goal: None, rule=GOAL)
    part.subscribe("/stop", "std_msgs/Empty", lambda _published: None, rule=STOPPING)
    assert graph.services.rules == {"/left/arm/stop": replace(STOPPING, arm="left")}
    assert graph.actions.rules == {"/left/wave": replace(GOAL, arm="left")}
    assert graph.rules == {"/left/stop": replace(STOPPING, arm="left")}


async def test_actions_stand_below_the_prefix_and_goals_name_them_in_full() -> None:
    graph, left = graph_with_left()
    results: list[Result] = []
    names = []

    def start(goal: ActionGoal) -> None:
        names.append(goal.action)
        goal.finish(GoalStatus.SUCCEEDED, {})

    left.node("part").offer_action("/wave", "example_interfaces/action/Fibonacci", start, rule=GOAL)
    graph.actions.send_goal(Node("client"), "/left/wave", "example_interfaces/Fibonacci", {"order": 1}, results.append)
    assert [result.status for result in results] == [GoalStatus.SUCCEEDED]
    assert names == ["/left/wave"] == [left.resolve("/wave")]
