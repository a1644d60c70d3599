"""Sessions of several clients, made up by chance: mostly sound operations, some with something wrong, some garbage.

A session is the bytes that `tests.fuzz.target.run_world` plays: what is found can be kept as a file of the corpus.
"""

import base64
import json
import struct
from random import Random
from typing import Any

import bson

from protocol.codecs import png
from protocol.errors import InterfaceError
from protocol.operations import qualify
from protocol.registry import Field, Kind, MessageType, Registry
from tests.fuzz.target import ADVANCE, BINARY, CLIENT, ESCAPES, FLUSH, SEPARATOR, TOKENS, escape

# Few names, or nobody would meet anybody; some are spelled in two ways.
TOPICS = ("/t", "t", "/t", "/u", "/v", "/w", "/rosout", "/a/_action/status", "/a/goal", "/ä b")
SERVICES = ("/s", "s", "/s", "/s#7", "/r")
ACTIONS = ("/a", "a", "/a", "/b")
NO_NAMES = ("", "/nobody", "/" + "x" * 300, "//", "/t ")
IDS = ("1", "2", "service_request:/s:1", "service_request:/s:2", "action_goal:/a:1", 7, "x" * 600)
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw", "zip")
LEVELS = ("none", "error", "warning", "info", "loud")

MESSAGE_TYPES = (
    "std_msgs/msg/String",
    "std_msgs/String",
    "std_msgs/msg/Header",
    "std_msgs/Time",
    "std_msgs/msg/UInt8MultiArray",
    "std_msgs/msg/Float64MultiArray",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/JointState",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "trajectory_msgs/msg/JointTrajectory",
    "diagnostic_msgs/msg/DiagnosticArray",
    "moveit_msgs/msg/RobotState",
    "rcl_interfaces/msg/Log",
    "actionlib_msgs/GoalID",
    "tf2_msgs/msg/TFMessage",
)
SERVICE_TYPES = (
    "std_srvs/srv/SetBool",
    "std_srvs/Trigger",
    "rcl_interfaces/srv/SetParameters",
    "moveit_msgs/srv/GetPositionIK",
)
ACTION_TYPES = (
    "control_msgs/action/GripperCommand",
    "control_msgs/action/FollowJointTrajectory",
    "control_msgs/GripperCommand",
)
NO_TYPES = ("", "std_msgs", "std_msgs/msg/Nothing", "a/b/c/d", "std_msgs/srv/String")

SHORT_INTEGERS = (0, 1, -1, 7, 127, 128, 255, 256, -129)
INTEGERS = (*SHORT_INTEGERS, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63, -(2**63) - 1, 2**64, 10**40)
FLOATS = (0.0, -0.0, 1.5, -2.0, 1e-310, 1e38, 3.5e38, 1e308, float("nan"), float("inf"), -float("inf"))
BASE64 = ("AAECAw==", "AAECAw")
TEXTS = ("", "a", "joint_1", "NaN", *BASE64, "ä\u2028\U0001f600", "\ud800", "\x00", "x" * 300, "-1", "null")
JUNK: tuple[Any, ...] = (None, True, False, [], {}, [[]], {"": {}}, {"data": None}, *INTEGERS[:6], *FLOATS[-3:], *TEXTS)

INTEGER_TYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "byte", "char", "octet")
SMALL = (0, 1, 7, 100, 127)

# Share of long frames, which threads read, and messages that are encoded later.
LONG = 0.003

# Share of names, values and fields that are not as they should be, in operations that are not sound.
WRONG = 0.05
SOUND = 0.65

# Shares of the clients: a, b, guest and viewer.
WEIGHTS = (36, 36, 12, 16)
GUEST = 2

FROM_PROVIDERS = ("advertise_service", "advertise_action", "service_response", "action_feedback", "action_result")

# Parts of interface files.
PRIMITIVES = ("int32", "uint8", "string", "wstring", "string<=5", "float64", "bool")
DECLARED = (*PRIMITIVES, "time", "Header", "std_msgs/Header", "Made")
ARRAYS = ("", "", "", "[]", "[3]", "[<=4]", "[0]", "[-1]", "[", "[99999999999999999999]")
DECLARED_NAMES = ("data", "a_b", "A", "MAX", "9x", "_a", "data__x", "")
ASSIGNED = ("", "", "=", " = ", " 1", "=-1", '="a"', "='a", " [1, 2]", "=1.5 #", "=nan", " true", "=1e400")

# Deeper messages are left at their defaults.
MAX_DEPTH = 4

MAX_FRAMES = 200


class SessionMaker:
    """Maker of sessions; the same seed makes the same, and pieces of a corpus are taken over."""

    def __init__(self, random: Random, registry: Registry, corpus: list[bytes]) -> None:
        self._random = random
        self._registry = registry
        self._parts = [part for data in corpus for part in data.split(SEPARATOR) if part]
        self._rosapi = sorted(
            name for name in registry.type_names() if name.startswith("rosapi_msgs/srv/") and "_" not in name[16:]
        )
        self._makers = (
            *[self._publish] * 6,
            *[self._subscribe] * 4,
            *[self._call_service] * 4,
            *[self._service_response] * 3,
            *[self._send_action_goal] * 3,
            *[self._action_report] * 3,
            *[self._call_rosapi] * 3,
            *[self._advertise] * 3,
            *[self._advertise_provider] * 3,
            self._withdraw,
            self._cancel,
            self._auth,
            self._level,
        )

        # Of the present session: what most clients take a name for, who offers it, and whether the guest is known.
        self._types: dict[str, str] = {}
        self._providers: dict[str, int] = {}
        self._known = False
        # Share of what is wrong in the present operation.
        self._wrong = 0.0

    def session(self) -> bytes:
        """Make a session, which `run_world` plays."""
        # Most are short; a few are long enough for limits and timers.
        wanted = min(MAX_FRAMES, 1 + int(self._random.expovariate(1 / 40)))
        self._types.clear()
        self._providers.clear()
        self._known = False
        parts: list[bytes] = []
        while len(parts) < wanted:
            parts += self._parts_of_one()
        return SEPARATOR.join(parts)

    def stream(self) -> bytes:
        """Make a stream of raw TCP, of BSON or of JSON, which `run_stream` plays."""
        random, count = self._random, self._random.randrange(1, 12)
        if random.random() < 0.5:
            frames = [self._bson(self._operation(), BINARY)[:-1] for _ in range(count)]
            for byte, escaped in reversed(ESCAPES):
                frames = [frame.replace(escaped, byte) for frame in frames]
        else:
            frames = [json.dumps(self._operation()).encode() for _ in range(count)]
        data = random.choice((b"", b"", b"\n", b"\0", b" ")).join(frames)
        return self._damaged(data) if random.random() < 0.3 else data

    def interface_file(self) -> bytes:
        """Make an interface file, which `run_interface_file` reads."""
        random = self._random
        lines = [
            f"{random.choice(DECLARED)}{random.choice(ARRAYS)} {random.choice(DECLARED_NAMES)}"
            f"{random.choice(ASSIGNED)}{random.choice(TEXTS[:6])}"
            if random.random() < 0.8
            else random.choice(("---", "# ---", "", "   ", "\t# a: b", "string X=a # b"))
            for _ in range(random.randrange(1, 20))
        ]
        data = "\n".join(lines).encode("utf-8", "replace")
        return self._damaged(data) if random.random() < 0.3 else data

    def _parts_of_one(self) -> list[bytes]:
        """One operation as frames, each with its control byte."""
        random = self._random
        dice = random.random()
        if dice < 0.03 and self._parts:
            return [self._damaged(random.choice(self._parts))]
        operation = self._operation()
        client = self._client(operation)
        if client == GUEST and not self._known and random.random() < 0.8:
            operation, self._known = {"op": "auth", "token": random.choice(TOKENS)}, True
        control = client & CLIENT | (client & 2) << 2
        if random.random() < 0.7:
            control |= FLUSH
        if random.random() < 0.05:
            control |= random.choice((1, 1, 1, 2, 6, 15)) << ADVANCE
        if dice < 0.10:
            return [self._bson(operation, control)]
        text = json.dumps(operation)
        if dice < 0.13:
            text = json.dumps({"op": "png", "data": self._picture(text), "id": random.choice(IDS)})
        elif dice < 0.17:
            return [self._part(piece.encode(), control) for piece in self._fragments(text)]
        elif dice < 0.19:
            middle = random.randrange(len(text))
            return [self._part(text[:middle].encode(), control), self._part(text[middle:].encode(), control)]
        elif dice < 0.21:
            text = "".join(json.dumps(self._operation()) for _ in range(random.randrange(1, 5))) + text
        elif dice < 0.24:
            return [self._damaged(self._part(text.encode(), control))]
        elif dice < 0.26:
            text = json.dumps(operation, ensure_ascii=False).encode("utf-8", "replace").decode("utf-8", "replace")
        return [self._part(text.encode(), control | (BINARY if random.random() < 0.1 else 0))]

    def _client(self, operation: dict[str, Any]) -> int:
        """Number of the client that sends an operation: what is about an offer, mostly the one that offers it."""
        (client,) = self._random.choices(range(len(WEIGHTS)), WEIGHTS)
        name = operation.get("service") or operation.get("action")
        if operation.get("op") in FROM_PROVIDERS and isinstance(name, str) and self._random.random() < 0.9:
            return self._providers.setdefault(qualify(name), client)
        return client

    def _part(self, frame: bytes, control: int) -> bytes:
        return (escape(frame) if control & BINARY else frame) + bytes([min(control, 254)])

    def _damaged(self, part: bytes) -> bytes:
        """A frame with a few bytes changed, left out, or doubled."""
        damaged = bytearray(part or b" ")
        for _ in range(self._random.randrange(1, 4)):
            place = self._random.randrange(len(damaged))
            match self._random.randrange(4):
                case 0:
                    damaged[place] = self._random.getrandbits(8)
                case 1:
                    del damaged[place : place + self._random.randrange(1, 8)]
                case 2:
                    damaged[place:place] = damaged[place : place + self._random.randrange(1, 30)]
                case _:
                    damaged.insert(place, self._random.choice(b'{}[]",:\\-.eE0 \x00\xf0'))
            if not damaged:
                return b"{" + part[-1:]
        return bytes(damaged)

    def _bson(self, operation: dict[str, Any], control: int) -> bytes:
        try:
            frame = bytearray(bson.encode(operation))
        except (OverflowError, ValueError, bson.errors.InvalidDocument):
            frame = bytearray(bson.encode({"op": "subscribe", "topic": "/t"}))
        if self._random.random() < 0.2:
            # The length at its beginning stays, or it would be read as JSON.
            frame[self._random.randrange(4, len(frame))] = self._random.getrandbits(8)
        return self._part(bytes(frame), control | BINARY)

    def _picture(self, text: str) -> str:
        if self._random.random() < 0.85:
            return png.encode(text.encode())
        picture = bytearray(base64.b64decode(png.encode(text.encode())))
        if self._random.random() < 0.3:
            picture[16:24] = struct.pack(
                ">II", self._random.choice((0, 1, 9, 2**31 - 1)), self._random.choice((0, 3, 99999))
            )
        else:
            picture[self._random.randrange(len(picture))] = self._random.getrandbits(8)
        return base64.b64encode(picture).decode()

    def _fragments(self, text: str) -> list[str]:
        random = self._random
        size = max(1, len(text) // random.randrange(1, 6))
        pieces = [text[start : start + size] for start in range(0, len(text), size)]
        mark = random.choice(IDS)
        frames = [
            {"op": "fragment", "id": mark, "data": piece, "num": number, "total": len(pieces)}
            for number, piece in enumerate(pieces)
        ]
        if random.random() < 0.3:
            random.shuffle(frames)
        if random.random() < 0.1:
            frames[0]["total"] = random.choice((0, 1, 10**6, -1, "2"))
        if random.random() < 0.1:
            frames.pop()
        return [json.dumps(frame) for frame in frames]

    # Operations.

    def _operation(self) -> dict[str, Any]:
        random = self._random
        self._wrong = 0.0 if random.random() < SOUND else WRONG
        operation = self._long() if random.random() < LONG else random.choice(self._makers)()
        if random.random() < 0.5:
            operation.setdefault("id", random.choice(IDS))
        if random.random() < 0.03:
            operation["fragment_size"] = random.choice((1, 10, 100, 2147483647, 0, -1, None, "a"))
        if random.random() < self._wrong:
            operation[random.choice(list(operation))] = random.choice(JUNK)
        if random.random() < self._wrong:
            del operation[random.choice(list(operation))]
        return operation

    def _publish(self) -> dict[str, Any]:
        topic = self._name(TOPICS)
        operation = {"op": "publish", "topic": topic, "msg": self._message(self._type(topic, MESSAGE_TYPES))}
        return operation | ({"latch": True} if self._random.random() < 0.1 else {})

    def _long(self) -> dict[str, Any]:
        random = self._random
        topic = self._name(TOPICS)
        type_name, value = random.choice(
            (
                ("std_msgs/msg/String", random.choice(TEXTS[1:-2]) * random.randrange(1, 20_000)),
                ("std_msgs/msg/Float64MultiArray", [random.choice(FLOATS) for _ in range(random.randrange(9000))]),
                ("sensor_msgs/msg/JointState", [random.choice(TEXTS) for _ in range(random.randrange(1500))]),
            )
        )
        field = "name" if type_name.endswith("JointState") else "data"
        self._types.setdefault(qualify(topic), type_name)
        return {"op": "publish", "topic": topic, "msg": {field: value}}

    def _subscribe(self) -> dict[str, Any]:
        random = self._random
        topic = self._name(TOPICS)
        operation: dict[str, Any] = {"op": "subscribe", "topic": topic}
        if random.random() < 0.5:
            operation["type"] = self._type(topic, MESSAGE_TYPES)
        if random.random() < 0.5:
            operation["compression"] = random.choice(COMPRESSIONS)
        if random.random() < 0.3:
            operation["throttle_rate"] = random.choice((0, 10, 5000, -1, 1.5, 2147483647))
            operation["queue_length"] = random.choice((0, 1, 5, 10**6, -1))
        return operation

    def _advertise(self) -> dict[str, Any]:
        topic = self._name(TOPICS)
        operation = {"op": "advertise", "topic": topic, "type": self._type(topic, MESSAGE_TYPES)}
        return operation | ({"latch": True, "qos": {"depth": 1}} if self._random.random() < 0.2 else {})

    def _advertise_provider(self) -> dict[str, Any]:
        if self._random.random() < 0.5:
            service = self._name(SERVICES)
            return {"op": "advertise_service", "service": service, "type": self._type(service, SERVICE_TYPES)}
        action = self._name(ACTIONS)
        return {"op": "advertise_action", "action": action, "type": self._type(action, ACTION_TYPES)}

    def _withdraw(self) -> dict[str, Any]:
        kind, name = self._random.choice(
            (
                ("unadvertise", {"topic": self._name(TOPICS)}),
                ("unsubscribe", {"topic": self._name(TOPICS)}),
                ("unadvertise_service", {"service": self._name(SERVICES)}),
                ("unadvertise_action", {"action": self._name(ACTIONS)}),
            )
        )
        return {"op": kind, **name}

    def _call_service(self) -> dict[str, Any]:
        service = self._name(SERVICES)
        operation: dict[str, Any] = {"op": "call_service", "service": service}
        operation["args"] = self._args(service, SERVICE_TYPES, "_Request")
        if self._random.random() < 0.3:
            operation["timeout"] = self._random.choice((0, 0.1, 5, 1e9, -1, None))
        return operation

    def _call_rosapi(self) -> dict[str, Any]:
        type_name = self._random.choice(self._rosapi)
        name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in type_name[16:]).lstrip("_")
        args = self._message(f"{type_name}_Request")
        if isinstance(args, dict):
            for field in args:
                if self._random.random() < 0.7:
                    pool = {"topic": TOPICS, "service": SERVICES, "node": ("/rosapi", "/a", "/b")}
                    args[field] = self._random.choice(
                        pool.get(field, (*MESSAGE_TYPES, *SERVICE_TYPES, *ACTION_TYPES, "p", "1"))
                    )
        return {"op": "call_service", "service": f"/rosapi/{name}", "args": args}

    def _service_response(self) -> dict[str, Any]:
        service = self._name(SERVICES)
        return {
            "op": "service_response",
            "service": service,
            "id": self._given_id("service_request", service),
            "values": self._args(service, SERVICE_TYPES, "_Response"),
            "result": self._random.random() < 0.7,
        }

    def _send_action_goal(self) -> dict[str, Any]:
        action = self._name(ACTIONS)
        return {
            "op": "send_action_goal",
            "action": action,
            "action_type": self._type(action, ACTION_TYPES),
            "args": self._args(action, ACTION_TYPES, "_Goal"),
            "feedback": self._random.random() < 0.7,
        }

    def _cancel(self) -> dict[str, Any]:
        return {"op": "cancel_action_goal", "action": self._name(ACTIONS), "id": self._random.choice(IDS)}

    def _action_report(self) -> dict[str, Any]:
        action = self._name(ACTIONS)
        given = {"action": action, "id": self._given_id("action_goal", action)}
        if self._random.random() < 0.5:
            return {"op": "action_feedback", **given, "values": self._args(action, ACTION_TYPES, "_Feedback")}
        given |= {"status": self._random.choice((0, 1, 2, 4, 5, 6, 99, -1)), "result": self._random.random() < 0.7}
        return {"op": "action_result", **given, "values": self._args(action, ACTION_TYPES, "_Result")}

    def _auth(self) -> dict[str, Any]:
        if self._random.random() < 0.2:
            proof = {"mac": "0" * 128, "client": "c", "dest": "d", "rand": "r", "t": 1.0, "level": "admin", "end": 2.0}
            return {"op": "auth", **proof}
        return {"op": "auth", "token": self._random.choice((*TOKENS, "wrong-token-wrong-token", 1, None))}

    def _level(self) -> dict[str, Any]:
        if self._random.random() < 0.5:
            return {"op": "set_level", "level": self._random.choice(LEVELS)}
        return {"op": "status", "level": self._random.choice(LEVELS), "msg": self._random.choice(TEXTS)}

    # Names.

    def _name(self, names: tuple[str, ...]) -> str:
        return self._random.choice(NO_NAMES if self._random.random() < self._wrong else names)

    def _type(self, name: str, types: tuple[str, ...]) -> str:
        """The type of a topic, service or action; seldom one that others do not take it for."""
        if self._random.random() < self._wrong:
            return self._random.choice((*NO_TYPES, *types))
        return self._types.setdefault(qualify(name.partition("#")[0]), self._random.choice(types))

    def _given_id(self, prefix: str, name: str) -> Any:
        """The id under which a provider gets a call or a goal; the first ones of a session."""
        if self._random.random() < 0.1:
            return self._random.choice(IDS)
        return f"{prefix}:{qualify(name.partition('#')[0])}:{self._random.randrange(1, 9)}"

    def _args(self, name: str, types: tuple[str, ...], suffix: str) -> Any:
        """A member of a service or an action."""
        kind: Kind = "srv" if types is SERVICE_TYPES else "action"
        try:
            type_name = self._registry.canonical(self._type(name, types), kind)
        except InterfaceError:
            return self._random.choice(JUNK)
        values = self._message(f"{type_name}{suffix}")
        if isinstance(values, dict) and self._random.random() < 0.1:
            return list(values.values())
        return values

    # Values.

    def _message(self, type_name: str, depth: int = 0) -> Any:
        if self._random.random() < self._wrong / 2:
            return self._random.choice(JUNK)
        try:
            message_type = self._registry.message(type_name)
        except InterfaceError:
            return {"data": self._random.choice(JUNK)}
        return self._fields(message_type, depth)

    def _fields(self, message_type: MessageType, depth: int) -> dict[str, Any]:
        # Fields left out get their defaults.
        share = self._random.choice((1.0, 1.0, 0.5))
        found = {
            field.name: self._field(field, depth) for field in message_type.fields if self._random.random() <= share
        }
        if self._random.random() < self._wrong:
            found[self._random.choice(("secs", "nsecs", "nanosec", "frame", "", "data"))] = self._random.choice(JUNK)
        return found

    def _field(self, field: Field, depth: int) -> Any:
        if self._random.random() < self._wrong:
            return self._random.choice(JUNK)
        if field.array is None:
            return self._value(field.base, depth)
        if depth >= MAX_DEPTH:
            return []
        if field.base in ("uint8", "byte", "octet", "char") and self._random.random() < 0.6:
            return base64.b64encode(self._random.randbytes(self._random.choice((0, 1, 3, 16, 200)))).decode()
        length = field.array.min_length if field.array.fixed else self._random.choice((0, 1, 2, 3, 6))
        if self._random.random() < self._wrong:
            length += 1
        return [self._value(field.base, depth + 1) for _ in range(length)]

    def _value(self, base: str, depth: int) -> Any:
        random = self._random
        if "/" in base:
            return self._message(base, depth + 1) if depth < MAX_DEPTH else {}
        if base in ("bool", "boolean"):
            return random.choice((True, False, 0, 1))
        if base in INTEGER_TYPES:
            return random.choice(SMALL if random.random() >= 4 * self._wrong else (*INTEGERS, 1.0, 1e3))
        if base in ("float32", "float64", "float", "double"):
            return random.choice((*FLOATS, *SMALL) if random.random() >= 4 * self._wrong else (*FLOATS, *INTEGERS))
        return random.choice(TEXTS)
