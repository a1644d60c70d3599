"""How long rosapi takes to answer, with a hundred topics."""

from __future__ import annotations

import asyncio
import time

from harness.figures import percentiles, print_table
from protocol.registry import Registry
from server.graph.node import Node
from server.graph.services import Response
from server.graph.topics import Graph
from server.rosapi import RosApi

TOPICS = 100
CALLS = 200

# Services that take an argument, and one for each.
ARGUMENTS: dict[str, dict[str, str]] = {
    "topics_for_type": {"type": "sensor_msgs/JointState"},
    "topic_type": {"topic": "/topic_7"},
    "node_details": {"node": "/talker"},
    "message_details": {"type": "moveit_msgs/MotionPlanRequest"},
    "service_request_details": {"type": "moveit_msgs/GetMotionPlan"},
    "publishers": {"topic": "/topic_7"},
}
SERVICES = ("topics", "topics_and_raw_types", "services", "nodes", "get_time", "get_param_names", *ARGUMENTS)


def run() -> None:
    """Call each service again and again."""
    asyncio.run(_measure())


async def _measure() -> None:
    registry = Registry.load()
    graph = Graph(registry)
    RosApi(graph)
    talker = Node("talker")
    types = [name for name in registry.type_names() if "/msg/" in name]
    for number in range(TOPICS):
        graph.advertise(talker, f"/topic_{number}", types[number % len(types)])
    rows = [[service, *percentiles(_times_s(graph, talker, service), 50, 99)] for service in SERVICES]
    print_table(f"rosapi with {TOPICS} topics [ms]", ["service", "p50", "p99"], rows)


def _times_s(graph: Graph, caller: Node, service: str) -> list[float]:
    times_s = []
    for _ in range(CALLS):
        answers: list[Response] = []
        started_s = time.perf_counter()
        graph.services.call(caller, f"/rosapi/{service}", ARGUMENTS.get(service, {}), answers.append)
        times_s.append(time.perf_counter() - started_s)
        assert answers[0].ok, answers[0].values
    return times_s
