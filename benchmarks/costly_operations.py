"""Costly operations of every kind, beyond those made of the types of services, topics and actions."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import Any

from benchmarks.costly_frames import Attack, call, op, picture
from protocol.codecs import bson

# A message type with many nested lists, of which an element of three bytes becomes hundreds of values.
SCENE_TYPE = "moveit_msgs/PlanningScene"

THOUSAND = range(1, 1001)
MEGA = 9_000_000


def operations_of_every_kind() -> Iterator[Attack]:
    """Make attacks with each op."""
    for make in (_topics, _subscriptions, _packed, _documents, _texts, _providers, _goals, _scenes, _others):
        yield from make()


def _objects(size_bytes: int) -> list[dict[str, Any]]:
    return [{}] * (size_bytes // 3)


def _scene_of(size_bytes: int) -> dict[str, Any]:
    return {"world": {"collision_objects": _objects(size_bytes)}}


def _topics() -> Iterator[Attack]:
    own = op("advertise", topic="/own", type=SCENE_TYPE)
    yield Attack("advertise topics", [op("advertise", topic=f"/a/{n}", type=SCENE_TYPE) for n in THOUSAND])
    ids = [op("advertise", topic="/a", type=SCENE_TYPE, id=f"{n}") for n in THOUSAND]
    yield Attack("advertise a topic under ids", ids)
    yield Attack("advertise and unadvertise", [own, op("unadvertise", topic="/own")] * 500)
    new = [op("publish", topic=f"/n/{n}", type=SCENE_TYPE, msg={}, latch=True) for n in THOUSAND]
    yield Attack("publish on new topics", new)
    for size in (1_000, 9_000):
        large = [op("publish", topic="/own", msg=_scene_of(size))] * 1000
        yield Attack(f"publish {size} B of objects on a new topic", large, [own])
        for compression in ("none", "cbor", "cbor-raw", "png"):
            before = [own, op("subscribe", topic="/own", type=SCENE_TYPE, compression=compression)]
            yield Attack(f"publish {size} B to itself, {compression}", large, before)
    small = [op("publish", topic="/own", type=SCENE_TYPE, msg=_scene_of(100))] * 1000
    pieces = op("subscribe", topic="/own", type=SCENE_TYPE, fragment_size=10)
    yield Attack("publish 100 B to itself, fragments of 10", small, [pieces])


def _subscriptions() -> Iterator[Attack]:
    options: list[dict[str, Any]] = [{}, {"fragment_size": 1}, {"fragment_size": 100}]
    options += [{"compression": compression} for compression in ("png", "cbor", "cbor-raw")]
    for topic in ("/robot_description", "/monitored_planning_scene", "/joint_states", "/diagnostics"):
        for each in options:
            told = " ".join(f"{key}={value}" for key, value in each.items())
            turns = [op("subscribe", topic=topic, **each), op("unsubscribe", topic=topic)] * 500
            yield Attack(f"subscribe and unsubscribe {topic} {told}".strip(), turns)
    ids = [op("subscribe", topic="/robot_description", id=f"{n}") for n in THOUSAND]
    yield Attack("subscribe a topic under ids", ids)
    latched = [
        op("advertise", topic="/large", type="std_msgs/Float64MultiArray", latch=True),
        op("publish", topic="/large", msg={"data": [0.5] * 200_000}),
    ]
    for compression in ("none", "cbor", "png"):
        turns = [op("subscribe", topic="/large", compression=compression), op("unsubscribe", topic="/large")] * 500
        yield Attack(f"subscribe and unsubscribe to 1 MB latched, {compression}", turns, latched)


def _packed() -> Iterator[Attack]:
    yield Attack("fragments, the last first, of 8 MB", _fragments(call("/nothing", "x" * 8_000_000), 10_000))
    blanks = op("png", data=picture(b" " * 9_990_000))
    yield Attack("fragments of a png of blanks", _fragments(blanks, 1000))
    ids = [op("fragment", id=f"{n % 16}", data="x" * 9000, num=n // 16, total=1000) for n in THOUSAND]
    yield Attack("fragments that are never whole", ids)
    objects = op("png", data=picture(call("/nothing", _objects(MEGA)).encode()))
    yield Attack("png of 9 MB of objects", [objects])
    yield Attack("56 x png of 9 MB of objects", [objects] * 56)
    yield Attack("56 x png of 9 MB of braces", [op("png", data=picture(b"{" * MEGA))] * 56)
    yield Attack("png of 6 MB of noise", [op("png", data=picture(os.urandom(3_000_000).hex().encode()))])
    yield Attack("png that is none", [op("png", data="x" * 9000)] * 1000)


def _fragments(text: str, count: int) -> list[str]:
    """Cut a text; from the last piece on, so that nothing is whole before all are there."""
    size = -(-len(text) // count)
    pieces = [text[start : start + size] for start in range(0, len(text), size)]
    return [
        op("fragment", id="f", data=piece, num=number, total=len(pieces))
        for number, piece in reversed(list(enumerate(pieces)))
    ]


def _documents() -> Iterator[Attack]:
    def document(service: str, args: object) -> bytes:
        return bson.encode({"op": "call_service", "service": service, "args": args})

    yield Attack("BSON, a list of 900,000 numbers", [document("/nothing", [0] * 900_000)])
    yield Attack("BSON, a list of 600,000 documents", [document("/check_goals", {"poses": [{}] * 600_000})])
    yield Attack("9 MB that only begin as BSON", [MEGA.to_bytes(4, "little") + b"\x04" * (MEGA - 4)])
    for service in ("/rosapi/topics", "/get_urdf", "/rosapi/topics_and_raw_types"):
        yield Attack(f"BSON {service}", [document(service, {})] * 1000)


def _texts() -> Iterator[Attack]:
    begin = '{"op":"call_service","service":"/nothing","args":'
    yield Attack("9 MB: objects", [call("/nothing", _objects(MEGA))])
    yield Attack("9 MB: lists", [begin + "[" + "[]," * (MEGA // 3) + "0]}"])
    yield Attack("9 MB: digits", [begin + "[" + "0," * (MEGA // 2) + "0]}"])
    yield Attack("9 MB: long numbers", [begin + "[" + "0.123456789012345678," * (MEGA // 21) + "0]}"])
    yield Attack("9 MB: a number", [begin + "1" * MEGA + "}"])
    yield Attack("9 MB: text", [call("/nothing", "x" * MEGA)])
    yield Attack("9 MB: escapes", [begin + '"' + "\\u00e9" * (MEGA // 6) + '"}'])
    yield Attack("9 MB: fields", [op("publish", topic="/stop", msg={f"{n}": 0 for n in range(600_000)})])
    yield Attack("9 MB: a field that is ignored", [op("publish", topic="/stop", msg={}, more=_objects(MEGA))])
    yield Attack("9 MB: a name", [call("x" * MEGA)])
    yield Attack("9 MB: an op", [op("x" * MEGA)])
    yield Attack("9 MB: an id", [op("call_service", service="/nothing", id="x" * MEGA)])
    yield Attack("9 MB: status", [op("status", msg="x" * MEGA)])
    yield Attack("9 MB: status of line ends", [op("status", msg="\n" * (MEGA // 2))])
    yield Attack("9 MB: two bytes a letter", ["é" * (MEGA // 2)])
    for name, text in (("braces", "{"), ("quotes", '"'), ("opened objects", '{"a":'), ("empty objects", "{}")):
        yield Attack(f"9 MB: {name}", [text * (MEGA // len(text))])
    yield Attack("9 MB: noise", [os.urandom(MEGA)])
    yield Attack("pieces of a text without an end", ['{"a":"', *["x" * 9000] * 1000])
    yield Attack("pieces of a list without an end", ['{"a":[', *["{}," * 3000] * 1000])


def _providers() -> Iterator[Attack]:
    offers = [op("advertise_service", service=f"/s/{n}", type="std_srvs/Trigger") for n in THOUSAND]
    yield Attack("advertise services", offers)
    own = op("advertise_service", service="/own", type="moveit_msgs/ApplyPlanningScene")
    yield Attack("calls of an own service", [call("/own", {"scene": _scene_of(9000)})] * 1000, [own])
    withdraw = op("unadvertise_service", service="/own")
    yield Attack("end of an own service that is called", [withdraw], [own, *[call("/own")] * 1000])
    scene = {"scene": _scene_of(9000)}
    responses = [
        op("service_response", service="/own", id=f"service_request:/own:{n}", result=True, values=scene)
        for n in THOUSAND
    ]
    large = op("advertise_service", service="/own", type="moveit_msgs/GetPlanningScene")
    yield Attack("responses of an own service", responses, [large, *[call("/own")] * 1000])
    yield Attack("responses of no call", responses)


def _goals() -> Iterator[Attack]:
    type_name = "moveit_msgs/MoveGroup"
    offers = [op("advertise_action", action=f"/s/{n}", type=type_name) for n in THOUSAND]
    yield Attack("advertise actions", offers)
    provider = op("advertise_action", action="/mine", type=type_name)
    goals = [
        op("send_action_goal", action="/mine", action_type=type_name, args={}, id=f"{n}", feedback=True)
        for n in THOUSAND
    ]
    yield Attack("goals of an own action", goals, [provider])
    cancels = [op("cancel_action_goal", action="/mine", id=f"{n}") for n in THOUSAND]
    yield Attack("cancels of own goals", cancels, [provider, *goals])
    yield Attack("cancels of one goal", [cancels[-1]] * 1000, [provider, *goals])
    values = {"planned_trajectory": {"joint_trajectory": {"points": _objects(9000)}}}
    ends = {"values": values, "status": 4, "result": True}
    for each, fields in (("action_result", ends), ("action_feedback", {"values": {"state": "x" * 9000}})):
        told = [op(each, action="/mine", id=f"action_goal:/mine:{n}", **fields) for n in THOUSAND]
        yield Attack(f"{each} of own goals", told, [provider, *goals])


def _box(number: int) -> dict[str, Any]:
    # On a grid below the table, where it is in nobody's way.
    position = {"x": 0.01 * (number % 100), "y": 0.01 * (number // 100), "z": -1.0}
    return {
        "id": f"box {number}",
        "header": {"frame_id": "base_link"},
        "pose": {"orientation": {"w": 1.0}},
        "primitives": [{"type": 1, "dimensions": [0.005, 0.005, 0.005]}],
        "primitive_poses": [{"position": position, "orientation": {"w": 1.0}}],
    }


def _sheet() -> dict[str, Any]:
    """Return an object with a mesh of 100,000 triangles."""
    vertices = [{"x": 0.001 * (number % 317), "y": 0.001 * (number // 317), "z": 0.0} for number in range(50_000)]
    corners = [number % 49_000 for number in range(100_000)]
    triangles = [{"vertex_indices": [corner, corner + 1, corner + 400]} for corner in corners]
    return {
        "id": "sheet",
        "header": {"frame_id": "base_link"},
        "pose": {"position": {"z": -1.0}, "orientation": {"w": 1.0}},
        "meshes": [{"vertices": vertices, "triangles": triangles}],
        "mesh_poses": [{"orientation": {"w": 1.0}}],
    }


def _scenes() -> Iterator[Attack]:
    def apply(*objects: dict[str, Any]) -> str:
        return call("/apply_planning_scene", {"scene": {"is_diff": True, "world": {"collision_objects": objects}}})

    filled = apply(*map(_box, THOUSAND))
    yield Attack("apply a scene of 1000 boxes", [filled])
    yield Attack("apply a scene of 1000 boxes, 20 times", [filled] * 20)
    yield Attack("apply a scene with a mesh of 100,000 triangles", [apply(_sheet())])
    yield Attack("apply 1000 scenes of a box", [apply(_box(number)) for number in THOUSAND])
    boxes = [op("publish", topic="/collision_object", msg=_box(number)) for number in THOUSAND]
    yield Attack("publish /collision_object", boxes)
    whole = call("/get_planning_scene", {"components": {"components": 1023}})
    yield Attack("/get_planning_scene of 1000 boxes", [whole] * 1000, [filled])
    for service in ("/check_state_validity", "/compute_ik", "/plan_kinematic_path"):
        yield Attack(f"{service} among 1000 boxes", [call(service)] * 1000, [filled])
    turns = [op(each, topic="/monitored_planning_scene") for each in ("subscribe", "unsubscribe")] * 500
    yield Attack("subscribe and unsubscribe to 1000 boxes", turns, [filled])


def _others() -> Iterator[Attack]:
    yield Attack("auth by a token", [op("auth", token="x" * 500)] * 1000)
    yield Attack("set_level", [op("set_level", level=level) for level in ("info", "none")] * 500)
    told = [op("status", level="error", msg="x" * 9000)] * 1000
    yield Attack("status of 9 kB", told)
    yield Attack("status of 9 kB, and /rosout", told, [op("subscribe", topic="/rosout")])
    refused = [op("publish", topic="/stop", msg={"x": "y" * 9000})] * 1000
    yield Attack("refused, with status", refused, [op("set_level", level="info"), op("subscribe", topic="/rosout")])
    yield Attack("an unknown op", [op("x" * 9000)] * 1000)
    yield Attack("an unknown service", [call("/nothing/" + "y" * 200, {"x": "y" * 9000})] * 1000)
    for service, args in (
        ("/rosapi/message_details", {"type": SCENE_TYPE}),
        ("/rosapi/service_request_details", {"type": "moveit_msgs/GetMotionPlan"}),
        ("/rosapi/service_response_details", {"type": "moveit_msgs/GetMotionPlan"}),
        ("/rosapi/topics_for_type", {"type": "sensor_msgs/JointState"}),
        ("/rosapi/services_for_type", {"type": "std_srvs/Trigger"}),
        ("/rosapi/set_param", {"name": "p", "value": json.dumps([0] * 4000)}),
        ("/file_server/get_file", {"name": "package://armbridge/nothing.stl"}),
        ("/save_robot_state", {"name": "mine", "state": {}}),
    ):
        yield Attack(f"{service}, with arguments", [call(service, args)] * 1000)
    parameters = [call("/rosapi/set_param", {"name": f"p{number}", "value": "0"}) for number in range(9900)]
    yield Attack("/rosapi/get_param_names of 10,000", [call("/rosapi/get_param_names")] * 1000, parameters)
