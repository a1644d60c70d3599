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
from protocol.operations import qualify
from protocol.registry import Kind, Registry
from tests.fuzz.target import ADVANCE, BINARY, CLIENT, ESCAPES, FLUSH, SEPARATOR, TOKENS, escape
from tests.helpers.messages import made_up

# Few names, or nobody would meet anybody; some are spelled in two ways.
TOPICS = ("/t", "t", "/t", "/u", "/v", "/w", "/rosout", "/a/_action/status", "/a/goal", "/ä b")
SERVICES = ("/s", "s", "/s", "/s#7", "/r")
ACTIONS = ("/a", "a", "/a", "/b")
NO_NAMES = ("", "/nobody", "/" + "x" * 300, "//", "/t ")
IDS = ("1", "2", "service_request:/s:1", "service_request:/s:2", "action_goal:/a:1", 7, "x" * 600)
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw", "zip")
LEVELS = ("none", "error", "warning", "info", "loud")

STATE, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
MESSAGE_TYPES = (
    *("std_msgs/msg/String", "std_msgs/String", "std_msgs/msg/Header", "std_msgs/Time", "std_msgs/msg/UInt8MultiArray"),
    *("std_msgs/msg/Float64MultiArray", STATE, "sensor_msgs/JointState", "sensor_msgs/msg/Image", POSE),
    *("sensor_msgs/msg/PointCloud2", "geometry_msgs/msg/PoseWithCovarianceStamped", "rcl_interfaces/msg/Log"),
    *("trajectory_msgs/msg/JointTrajectory", "diagnostic_msgs/msg/DiagnosticArray", "moveit_msgs/msg/RobotState"),
    *("actionlib_msgs/GoalID", "tf2_msgs/msg/TFMessage"),
)
PARAMETERS = "rcl_interfaces/srv/SetParameters"
SERVICE_TYPES = ("std_srvs/srv/SetBool", "std_srvs/Trigger", PARAMETERS, "moveit_msgs/srv/GetPositionIK")
FOLLOW = "control_msgs/action/FollowJointTrajectory"
ACTION_TYPES = ("control_msgs/action/GripperCommand", FOLLOW, "control_msgs/GripperCommand")
NO_TYPES = ("", "std_msgs", "std_msgs/msg/Nothing", "a/b/c/d", "std_msgs/srv/String")

INTEGERS = (0, 1, -1, 7, 127, 128, 255, 256, -129, 2**31 - 1, 2**32, 2**53 + 1, 2**63, -(2**63) - 1, 2**64, 10**40)
FLOATS = (0.0, -0.0, 1.5, -2.0, 1e-310, 1e38, 3.5e38, 1e308, 1e3, float("nan"), float("inf"), -float("inf"))
BASE64 = ("AAECAw==", "AAECAw")
TEXTS = ("", "a", "joint_1", "NaN", *BASE64, "ä\u2028\U0001f600", "\ud800", "\x00", "x" * 300, "-1", "null")
OBJECTS: tuple[Any, ...] = ([], {}, [[]], [7, 255], {"": {}}, {"data": None})
JUNK = (None, True, False, *OBJECTS, *INTEGERS, *FLOATS, *TEXTS, *NO_NAMES, *NO_TYPES, *MESSAGE_TYPES[:4])

# Share of long frames, which threads read, and messages that are encoded later.
LONG = 0.003

# Share of names, values and fields that are not as they should be, in operations that are not sound.
WRONG = 0.05
SOUND = 0.65

# Shares of the clients: a, b, guest and viewer.
WEIGHTS = (36, 36, 12, 16)
GUEST = 2

FROM_PROVIDERS = ("advertise_service", "advertise_action", "service_response", "action_feedback", "action_result")

SHARES = {
    24: ("publish",),
    16: ("subscribe", "call_service"),
    12: ("rosapi", "service_response", "send_action_goal", "advertise"),
    6: ("action_feedback", "action_result", "advertise_service", "advertise_action"),
    4: ("cancel_action_goal", "auth"),
    2: ("set_level", "status"),
    1: ("unadvertise", "unsubscribe", "unadvertise_service", "unadvertise_action"),
}
OPERATIONS = [op for share, ops in SHARES.items() for op in ops * share]

# Parts of interface files.
PRIMITIVES = ("int32", "uint8", "string", "wstring", "string<=5", "float64", "bool")
DECLARED = (*PRIMITIVES, "time", "Header", "std_msgs/Header", "Made")
ARRAYS = ("", "", "", "[]", "[3]", "[<=4]", "[0]", "[-1]", "[", "[99999999999999999999]")
DECLARED_NAMES = ("data", "a_b", "A", "MAX", "9x", "_a", "data__x", "")
ASSIGNED = ("", "", "=", " = ", " 1", "=-1", '="a"', '="a', " [1, 2]", "=1.5 #", "=nan", " true", "=1e400")

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
        # Of the present session: what most clients take a name for, who offers it, and whether the guest is known.
        self._types: dict[str, str] = {}
        self._providers: dict[str, int] = {}
        self._known = False

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
            "".join(map(random.choice, (DECLARED, ARRAYS, " ", DECLARED_NAMES, ASSIGNED, TEXTS[:6])))
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
        picture, random = bytearray(base64.b64decode(png.encode(text.encode()))), self._random
        if random.random() < 0.05:
            picture[16:24] = struct.pack(">II", random.choice((0, 1, 9, 2**31 - 1)), random.choice((0, 3, 99999)))
        elif random.random() < 0.1:
            picture[random.randrange(len(picture))] = random.getrandbits(8)
        return base64.b64encode(picture).decode()

    def _fragments(self, text: str) -> list[str]:
        random = self._random
        size = max(1, len(text) // random.randrange(1, 6))
        pieces = [text[start : start + size] for start in range(0, len(text), size)]
        shared = {"op": "fragment", "id": random.choice(IDS), "total": len(pieces)}
        frames: list[dict[str, Any]] = [{**shared, "data": piece, "num": number} for number, piece in enumerate(pieces)]
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
        op = random.choice(OPERATIONS)
        operation = self._long() if random.random() < LONG else {"op": op, **self._sound(op)}
        if random.random() < 0.5:
            operation.setdefault("id", random.choice(IDS))
        if random.random() < 0.03:
            operation["fragment_size"] = random.choice((1, 10, 100, 2147483647, 0, -1, None, "a"))
        return operation if random.random() < SOUND else self._spoiled(operation)

    def _spoiled(self, value: Any) -> Any:
        """A value in which some parts are wrong or left out, and few are added."""
        random = self._random
        if isinstance(value, dict):
            spoiled = {
                key: random.choice(JUNK) if random.random() < WRONG else self._spoiled(member)
                for key, member in value.items()
                if random.random() > WRONG
            }
            more = random.choice(("secs", "nsecs", "nanosec", "frame", "", "data"))
            return spoiled | ({more: random.choice(JUNK)} if random.random() < WRONG else {})
        if isinstance(value, list):
            return [random.choice(JUNK) if random.random() < WRONG else self._spoiled(member) for member in value]
        return value

    def _long(self) -> dict[str, Any]:
        random, topic = self._random, self._random.choice(TOPICS)
        type_name, msg = random.choice(
            (
                ("std_msgs/msg/String", {"data": random.choice(TEXTS[1:-2]) * random.randrange(1, 20_000)}),
                ("std_msgs/msg/Float64MultiArray", {"data": random.choices(FLOATS, k=random.randrange(9000))}),
                ("sensor_msgs/msg/JointState", {"name": random.choices(TEXTS, k=random.randrange(1500))}),
            )
        )
        self._types.setdefault(qualify(topic), type_name)
        return {"op": "publish", "topic": topic, "msg": msg}

    def _sound(self, op: str) -> dict[str, Any]:
        """Fields of an operation, with nothing wrong in them but perhaps a name that nobody offers."""
        choose, chance = self._random.choice, self._random.random
        topic, service, action = choose(TOPICS), choose(SERVICES), choose(ACTIONS)
        match op:
            case "publish":
                return {"topic": topic, "msg": self._message(topic), **({"latch": True} if chance() < 0.1 else {})}
            case "subscribe":
                asked: dict[str, Any] = {"topic": topic}
                asked |= {"type": self._type(topic)} if chance() < 0.5 else {}
                asked |= {"compression": choose(COMPRESSIONS)} if chance() < 0.5 else {}
                if chance() < 0.3:
                    asked["throttle_rate"] = choose((0, 10, 5000, -1, 1.5, 2147483647))
                    asked["queue_length"] = choose((0, 1, 5, 10**6, -1))
                return asked
            case "call_service":
                timeout = {"timeout": choose((0, 0.1, 5, 1e9, -1, None))} if chance() < 0.3 else {}
                return {"service": service, "args": self._message(service, "srv", "_Request"), **timeout}
            case "rosapi":
                return self._call_of_rosapi()
            case "service_response":
                values = self._message(service, "srv", "_Response")
                mark = self._given_id("service_request", service)
                return {"service": service, "id": mark, "values": values, "result": chance() < 0.7}
            case "send_action_goal":
                goal = {"args": self._message(action, "action", "_Goal"), "feedback": chance() < 0.7}
                return {"action": action, "action_type": self._type(action, "action"), **goal}
            case "action_feedback":
                values = self._message(action, "action", "_Feedback")
                return {"action": action, "id": self._given_id("action_goal", action), "values": values}
            case "action_result":
                done = {"status": choose((0, 1, 2, 4, 5, 6, 99, -1)), "result": chance() < 0.7}
                values = self._message(action, "action", "_Result")
                return {"action": action, "id": self._given_id("action_goal", action), "values": values, **done}
            case "advertise":
                more = {"latch": True, "qos": {"depth": 1}} if chance() < 0.2 else {}
                return {"topic": topic, "type": self._type(topic), **more}
            case "advertise_service" | "unadvertise_service":
                return {"service": service, "type": self._type(service, "srv")}
            case "advertise_action" | "unadvertise_action":
                return {"action": action, "type": self._type(action, "action")}
            case "cancel_action_goal":
                return {"action": action, "id": choose(IDS)}
            case "auth":
                times = {"t": 1.0, "end": 2.0}
                proof = {"mac": "0" * 128, "client": "c", "dest": "d", "rand": "r", "level": "admin", **times}
                return proof if chance() < 0.2 else {"token": choose((*TOKENS, "wrong-token-wrong-token", 1, None))}
            case "set_level":
                return {"level": choose(LEVELS)}
            case "status":
                return {"level": choose(LEVELS), "msg": choose(TEXTS)}
        return {"topic": topic}

    def _call_of_rosapi(self) -> dict[str, Any]:
        type_name, random = self._random.choice(self._rosapi), self._random
        name = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in type_name[16:]).lstrip("_")
        pool = {"topic": TOPICS, "service": SERVICES, "node": ("/rosapi", "/a", "/b")}
        others = (*MESSAGE_TYPES, *SERVICE_TYPES, *ACTION_TYPES, "p", "1")
        args = self._made(f"{type_name}_Request")
        args |= {field: random.choice(pool.get(field, others)) for field in args if random.random() < 0.7}
        return {"op": "call_service", "service": f"/rosapi/{name}", "args": args}

    # Names and values.

    def _type(self, name: str, kind: Kind = "msg") -> str:
        """The type of a topic, service or action."""
        types = {"msg": MESSAGE_TYPES, "srv": SERVICE_TYPES, "action": ACTION_TYPES}[kind]
        return self._types.setdefault(qualify(name.partition("#")[0]), self._random.choice(types))

    def _given_id(self, prefix: str, name: str) -> Any:
        """The id under which a provider gets a call or a goal; the first ones of a session."""
        if self._random.random() < 0.1:
            return self._random.choice(IDS)
        return f"{prefix}:{qualify(name.partition('#')[0])}:{self._random.randrange(1, 9)}"

    def _message(self, name: str, kind: Kind = "msg", suffix: str = "") -> Any:
        """A message of a topic, or a member of a service or an action, which may be a list."""
        type_name = self._registry.canonical(self._type(name, kind), kind)
        values = self._made(f"{type_name}{suffix}")
        return list(values.values()) if suffix and self._random.random() < 0.1 else values

    def _made(self, type_name: str) -> dict[str, Any]:
        # Fields left out get their defaults.
        share = self._random.choice((1.0, 1.0, 0.5))
        message = made_up(self._registry, type_name, self._random.getrandbits(32))
        return {name: value for name, value in message.items() if self._random.random() <= share}
