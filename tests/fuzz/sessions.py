"""Sessions of several clients, made up by chance: cases of conformance mixed, some with something wrong, some garbage.

A session is the bytes that `tests.fuzz.target.run_world` plays: what is found can be kept as a file of the corpus.
"""

import base64
import json
import re
import struct
from random import Random
from typing import Any

import bson

from protocol.codecs import png
from protocol.registry import Registry
from tests.conformance.cases import cases, frame_of
from tests.fuzz.target import ADVANCE, BINARY, CLIENT, FLUSH, SEPARATOR, TOKENS, escape
from tests.helpers.messages import MESSAGE_TYPES, made_up

IDS = ("1", "2", "service_request:/s:1", "service_request:/s:2", "action_goal:/a:1", 7, "x" * 600)
NAMES = ("", "/nobody", "/" + "x" * 300, "//", "/t ", "/\u00e4 b", "std_msgs", "std_msgs/msg/Nothing", "a/b/c/d")
INTEGERS = (0, 1, -1, 7, 127, 128, 255, 256, -129, 2**31 - 1, 2**32, 2**53 + 1, 2**63, -(2**63) - 1, 2**64, 10**40)
FLOATS = (0.0, -0.0, 1.5, -2.0, 1e-310, 1e38, 3.5e38, 1e308, 1e3, float("nan"), float("inf"), -float("inf"))
BASE64 = ("AAECAw==", "AAECAw")
TEXTS = ("", "a", "joint_1", "NaN", *BASE64, "ä\u2028\U0001f600", "\ud800", "\x00", "x" * 300, "-1", "null")
OBJECTS: tuple[Any, ...] = ([], {}, [[]], [7, 255], {"": {}}, {"data": None})
JUNK = (None, True, False, *OBJECTS, *INTEGERS, *FLOATS, *TEXTS, *NAMES, *IDS)

# Few types, or nobody would meet anybody; and topics that the program publishes itself.
LONG_TYPES = ("String", "Float64MultiArray", "JointState", "PoseArray")
TYPES = [name for name in MESSAGE_TYPES if name.split("/")[-1] in LONG_TYPES or MESSAGE_TYPES.index(name) % 80 == 0]
OWN_TOPICS = ("/rosout", "/grip/_action/status")

# Share of long frames, which threads read, and messages that are encoded later.
LONG = 0.006

# Share of messages of any type, calls of rosapi and proofs of identity, in place of a case's own operation.
OTHER = 0.3

# Share of names, values and fields that are not as they should be, in operations that are not sound.
WRONG = 0.05
SOUND = 0.65

# Number of the client, of those in `run_world`, for each client of a case: the first two may do everything.
CLIENTS = ((0, 1, 2, 3), (1, 0, 2, 3), (0, 1, 3, 2), (1, 0, 3, 2), (0, 3, 1, 2), (2, 0, 1, 3))
GUEST = 2


MAX_FRAMES = 200


class SessionMaker:
    """Maker of sessions; the same seed makes the same, and pieces of a corpus are taken over."""

    def __init__(self, random: Random, registry: Registry, corpus: list[bytes]) -> None:
        self._random = random
        self._registry = registry
        self._parts = [part for data in corpus for part in data.split(SEPARATOR) if part]
        self._cases = [[step for step in case["steps"] if "client" in step and _sent(step)] for case in cases()]
        operations = [step["send"] for case in self._cases for step in case if isinstance(step.get("send"), dict)]
        self._operations = operations
        self._topics = sorted({str(each["topic"]) for each in operations if "topic" in each})
        self._rosapi = [name for name in registry.type_names() if re.fullmatch(r"rosapi_msgs/srv/[A-Za-z]+", name)]
        # True when the guest of the present session is known.
        self._known = False

    def session(self) -> bytes:
        """Make a session, which `run_world` plays."""
        # Most are short; a few are long enough for limits and timers.
        wanted = min(MAX_FRAMES, 1 + int(self._random.expovariate(1 / 40)))
        self._known = False
        parts: list[bytes] = []
        while len(parts) < wanted:
            parts += self._parts_of_cases()
        return SEPARATOR.join(parts[:wanted])

    def _parts_of_cases(self) -> list[bytes]:
        """A few cases, each in its order, mixed."""
        random = self._random
        left = [(list(case), self._clients(case)) for case in random.sample(self._cases, 3)]
        parts: list[bytes] = []
        while left := [(steps, numbers) for steps, numbers in left if steps]:
            steps, numbers = random.choice(left)
            step = steps.pop(0)
            parts += self._parts_of(step, numbers.get(step["client"], 0))
        return parts

    def _clients(self, case: list[dict[str, Any]]) -> dict[str, int]:
        """Choose who plays the clients of a case."""
        names = sorted({step["client"] for step in case})
        return dict(zip(names, self._random.choice(CLIENTS), strict=False))

    def _parts_of(self, step: dict[str, Any], client: int) -> list[bytes]:
        """A step of a case as frames, each with its control byte."""
        random = self._random
        dice = random.random()
        if dice < 0.03 and self._parts:
            return [self._damaged(random.choice(self._parts))]
        control = client & CLIENT | (client & 2) << 2
        if random.random() < 0.7:
            control |= FLUSH
        if random.random() < 0.05:
            control |= random.choice((1, 1, 1, 2, 6, 15)) << ADVANCE
        operation = step.get("send", step.get("send_bson"))
        if not isinstance(operation, dict):
            frame = frame_of(step)
            is_text = isinstance(frame, str)
            return [self._part(frame.encode() if is_text else frame, control | (0 if is_text else BINARY))]
        operation = self._operation(operation)
        if client == GUEST and not self._known and random.random() < 0.8:
            operation, self._known = {"op": "auth", "token": random.choice(TOKENS)}, True
        if dice < 0.10 or "send_bson" in step:
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

    def _operation(self, own: dict[str, Any] | None = None) -> dict[str, Any]:
        """An operation of a case, or another one, mostly with nothing wrong in it."""
        random = self._random
        operation = dict(own or random.choice(self._operations))
        if random.random() < LONG:
            operation = self._long()
        elif random.random() < OTHER:
            operation = random.choice((*[self._of_any_type] * 8, *[self._call_of_rosapi] * 4, self._auth))()
        elif isinstance(operation.get("id"), str) and random.random() < 0.5:
            # A session has more calls and goals than a case.
            operation["id"] = re.sub(r"(?<=:)\d+$", lambda _: str(random.randrange(1, 9)), operation["id"])
        if random.random() < 0.1:
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
        random = self._random
        type_name, msg = random.choice(
            (
                ("std_msgs/msg/String", {"data": random.choice(TEXTS[1:-2]) * random.randrange(1, 20_000)}),
                ("std_msgs/msg/Float64MultiArray", {"data": random.choices(FLOATS, k=random.randrange(9000))}),
                ("sensor_msgs/msg/JointState", {"name": random.choices(TEXTS, k=random.randrange(1500))}),
                ("geometry_msgs/msg/PoseArray", {"poses": [{}] * random.randrange(9000)}),
            )
        )
        return {"op": "publish", "topic": f"/{type_name}", "msg": msg}

    def _of_any_type(self) -> dict[str, Any]:
        """An advertisement, a subscription or a message of a type, on a topic that is called after it."""
        random = self._random
        type_name = random.choice(TYPES)
        topic = random.choice(OWN_TOPICS) if random.random() < 0.1 else f"/{type_name}"
        match random.randrange(5):
            case 0:
                return {"op": "advertise", "topic": topic, "type": type_name, "latch": random.random() < 0.2}
            case 1 | 2:
                compression = random.choice(("none", "png", "cbor", "cbor-raw", "zip"))
                paced = {"throttle_rate": random.choice((0, 10, 5000, -1)), "queue_length": random.choice((0, 1, 5))}
                asked = {"op": "subscribe", "topic": topic, "type": type_name, "compression": compression}
                return asked | (paced if random.random() < 0.3 else {})
            case _:
                return {"op": "publish", "topic": topic, "msg": self._made(type_name)}

    def _auth(self) -> dict[str, Any]:
        shown = self._random.choice(({}, {"token": "wrong-token-wrong-token"}, {"token": TOKENS[-1]}))
        return {"op": "auth", **shown}

    def _call_of_rosapi(self) -> dict[str, Any]:
        type_name, random = self._random.choice(self._rosapi), self._random
        name = re.sub("(?<=[a-z])(?=[A-Z])", "_", type_name.rpartition("/")[2]).lower()
        others = (*TYPES, "std_srvs/srv/SetBool", "/rosapi", "/switch", "p", "1")
        args = self._made(f"{type_name}_Request")
        args |= {
            field: random.choice(self._topics if field == "topic" else others)
            for field in args
            if random.random() < 0.7
        }
        return {"op": "call_service", "service": f"/rosapi/{name}", "args": args}

    def _made(self, type_name: str) -> dict[str, Any]:
        # Fields left out get their defaults.
        share = self._random.choice((1.0, 1.0, 0.5))
        message = made_up(self._registry, type_name, self._random.getrandbits(32))
        return {name: value for name, value in message.items() if self._random.random() <= share}


def _sent(step: dict[str, Any]) -> bool:
    return any(key.startswith("send") for key in step)
