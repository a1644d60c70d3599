"""Single questions and messages over rosbridge, for tests that have no event loop."""

from __future__ import annotations

import json
from typing import Any

from websockets.sync.client import ClientConnection, connect

ANSWER_TIMEOUT_S = 20.0


def call(url: str, service: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
    """Call a service and wait for its values."""
    with connect(url) as websocket:
        return call_on(websocket, service, args)


def call_on(websocket: ClientConnection, service: str, args: dict[str, Any] | None = None) -> dict[str, Any]:
    """As :func:`call`, on a connection that stays."""
    websocket.send(json.dumps({"op": "call_service", "service": service, "args": args or {}}))
    answer = json.loads(websocket.recv(timeout=ANSWER_TIMEOUT_S))
    assert answer["result"], answer
    values: dict[str, Any] = answer["values"]
    return values


def goal(url: str, topic: str, msg: dict[str, Any]) -> dict[str, Any]:
    """Send a goal and wait for its answer."""
    with connect(url) as websocket:
        websocket.send(
            json.dumps({"op": "subscribe", "topic": "/moveit_goal_result", "type": "moveit_msgs/MoveItErrorCodes"})
        )
        websocket.send(json.dumps({"op": "publish", "topic": topic, "msg": msg}))
        answer: dict[str, Any] = json.loads(websocket.recv(timeout=ANSWER_TIMEOUT_S))["msg"]
    return answer


def tip(url: str) -> tuple[float, float, float]:
    """Where the tip of the arm is now, in the root link's frame [m]."""
    answer = call(url, "/compute_fk", {"fk_link_names": ["gripper_frame_link"]})
    position = answer["pose_stamped"][0]["pose"]["position"]
    return float(position["x"]), float(position["y"]), float(position["z"])
