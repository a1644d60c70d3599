"""Cost of the services of the planning scene, called as compas_fab calls them."""

from __future__ import annotations

import asyncio
import gc
import itertools
import json as python_json
import time
from collections.abc import Callable, Collection
from typing import Any, cast

import numpy as np

from harness.figures import percentiles, print_table
from protocol.codecs import json
from protocol.registry import Registry
from robot.arm import Arm
from robot.description.robot_folder import built_in
from robot.messages import ArmState, Mode
from server.execution.monitors import CurrentState
from server.graph.permissions import Node
from server.graph.services import Response
from server.graph.topics import Graph
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.interface import APPLY, GET, SceneInterface
from server.moveit.scene.scene_state import AssumedStates, SceneState

OBJECTS = 50

# compas_fab 2.0.1 calls so often for 21 states that it plans for, checks and solves; and asks for these components.
GETS, APPLIES, COMPONENTS = 27, 57, 671

ROUNDS = 20  # the pattern is over in milliseconds


class _StandingArm:
    """Arm that stands still, without its process."""

    def __init__(self, joints: tuple[str, ...]) -> None:
        at = np.zeros(len(joints))
        self.state = ArmState(time.time(), Mode.HOLDING, joints, position_rad=at, goal_rad=at)

    def part(self, _joint_names: Collection[str]) -> _StandingArm:
        """Return the arm itself."""
        return self


def run() -> None:
    """Call as the gateway does, from the text of a request to the text of its response; without the socket."""
    asyncio.run(_measure())


async def _measure() -> None:
    robot, graph, client = built_in("so101").model, Graph(Registry.load()), Node("client", remote=True)
    arm = _StandingArm(tuple(joint.name for joint in robot.movable_joints))
    current = CurrentState(cast(Arm, arm))
    scene = SceneInterface(graph, SceneState(robot), AssumedStates(robot), current, MoveItParameters())

    def call(service: str, request: bytes) -> bytes:
        answers: list[Response] = []
        graph.services.call(client, service, json.decode(request), answers.append)
        assert answers[0].ok, answers[0].values
        return json.encode(answers[0].values)

    call(APPLY, _change([_box(number) for number in range(OBJECTS)]))
    wanted = json.encode({"components": {"components": COMPONENTS}})
    sent_back = _as_compas_fab_sends_it_back(call(GET, wanted))
    moves = itertools.cycle([_change([_move(number, z_m) for number in range(OBJECTS)]) for z_m in (0.1, 0.2)])
    stays = _change([_move(number, 0.1) for number in range(OBJECTS)])
    decoded = json.decode(sent_back)
    rows = [
        ("get", GETS, lambda: call(GET, wanted)),
        ("apply, the whole scene sent back", APPLIES, lambda: call(APPLY, sent_back)),
        ("apply, every object moved to where it is", APPLIES, lambda: call(APPLY, stays)),
        ("apply, every object moved elsewhere", APPLIES, lambda: call(APPLY, next(moves))),
        ("for comparison: Python's json.dumps of the scene", GETS, lambda: python_json.dumps(decoded)),
        ("for comparison: Python's json.loads of the scene", APPLIES, lambda: python_json.loads(sent_back)),
    ]
    # As the server does once it has started.
    gc.collect()
    gc.freeze()
    _print(rows, len(sent_back))
    scene.close()


def _print(rows: list[tuple[str, int, Callable[[], Any]]], size: int) -> None:
    taken_s = [_cpu_s(action, count * ROUNDS) for _, count, action in rows]
    writing_s = float(np.median(taken_s[-2]))
    print_table(
        f"Planning scene services with {OBJECTS} objects, {size / 1000:.0f} kB of JSON; CPU a call [ms]",
        ["call", "calls", "p50", "p99", "by json.dumps"],
        [
            [name, str(len(times)), *percentiles(times, 50, 99, digits=3), f"{np.median(times) / writing_s:.2f}"]
            for (name, _, _), times in zip(rows, taken_s, strict=True)
        ],
    )


def _cpu_s(action: Callable[[], Any], times: int) -> list[float]:
    taken = []
    for _ in range(times):
        started_s = time.process_time()
        action()
        taken.append(time.process_time() - started_s)
    return taken


def _change(objects: list[dict[str, Any]]) -> bytes:
    return json.encode({"scene": {"is_diff": True, "world": {"collision_objects": objects}}})


def _box(number: int) -> dict[str, Any]:
    shape = {"type": 1, "dimensions": [0.04, 0.04, 0.04]}
    return {"id": f"box {number}", "pose": _pose(number, 0.1), "primitives": [shape]}


def _move(number: int, z_m: float) -> dict[str, Any]:
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base_link"}
    return {"header": header, "id": f"box {number}", "pose": _pose(number, z_m), "operation": 3}


def _pose(number: int, z_m: float) -> dict[str, Any]:
    orientation = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {"position": {"x": 0.5, "y": 0.05 * number, "z": z_m}, "orientation": orientation}


def _as_compas_fab_sends_it_back(response: bytes) -> bytes:
    """Return the scene as a difference, without the fields that compas_fab's own classes do not have."""
    scene: Any = python_json.loads(response)["scene"]
    for thing in scene["world"]["collision_objects"]:
        del thing["subframe_names"], thing["subframe_poses"]
        for primitive in thing["primitives"]:
            del primitive["polygon"]
    return json.encode({"scene": {**scene, "is_diff": True}})
