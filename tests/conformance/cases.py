"""Conformance cases: what clients send and what must come back, as data.

A case is ``{"name", "section", "steps"}``, ``"relay_unknown_types": true`` where the server is to be configured
so, ``"rosapi": true`` where it offers rosapi, and ``"interfaces": true`` where it has the types of the packages in
``interfaces``.
A step is about one client, or lets time pass; a client connects with its first step; every case starts with a fresh
server.

| step | what happens |
|---|---|
| ``{"client", "send": object}`` | a text frame with the object as JSON |
| ``{"client", "send_text": text}``, ``{"client", "send_binary": text}`` | a frame of this text, as text or as UTF-8 |
| ``{"client", "send_hex": text}`` | a binary frame of these bytes |
| ``{"client", "send_bson": object}`` | a binary frame with the object as BSON |
| ``{"client", "expect": object}`` | the client's next frame is JSON text, equal to the letter, keys in this order |
| ``{"client", "expect_any_order": [object, ...]}`` | the next frames, in whatever order |
| ``{"client", "expect_bson": object}``, ``{"client", "expect_cbor": object}`` | a binary frame of this content |
| ``{"client", "expect_png": object}`` | JSON text with a picture that carries this content |
| ``{"client", "expect_fragments": object, "pieces": number}`` | so many fragments, which together are this |
| ``{"client", "expect_nothing": true}`` | nothing is there for the client |
| ``{"client", "close": true}`` | the client leaves |
| ``{"advance_ms": number}`` | time passes |

In what is expected ``"<any>"`` stands for any value, ``"<... words ...>"`` for text that contains the words, and
``"<hex 0a 0b>"`` for these bytes.

Cases that differ by values are a family: ``{"section", "default", "steps", "each": [row, ...]}``. Each row is a case
with these steps, in which ``"<=id>"`` stands for the row's ``"id"``, or for that of ``"default"``. A field whose value
neither has is left out. A row has its own name, and a section where the family's is not right for it.
"""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

import bson
import cbor2

from protocol.codecs import png

FOLDER = Path(__file__).parent
INTERFACES = FOLDER / "interfaces"

ANY = "<any>"
CONTAINS = ("<... ", " ...>")
BYTES = ("<hex ", ">")
VALUE = ("<=", ">")


class Player(Protocol):
    """Plays steps on some server."""

    async def send(self, client: str, frame: str | bytes) -> None: ...
    async def next_frame(self, client: str) -> bytes | str | None:
        """The client's next frame, text as str; None when none comes."""

    async def nothing_comes(self, client: str) -> bool: ...
    async def close(self, client: str) -> None: ...
    async def advance(self, seconds: float) -> None: ...


def cases() -> list[dict[str, Any]]:
    """Every case of every file."""
    entries = [entry for path in sorted(FOLDER.glob("*.json")) for entry in json.loads(path.read_text())]
    return [case for entry in entries for case in (_family(**entry) if "each" in entry else [entry])]


def _family(
    each: list[dict[str, Any]], steps: list[Any], default: dict[str, Any] | None = None, **shared: Any
) -> Iterator[dict[str, Any]]:
    """Go over the cases of a family."""
    for row in each:
        own = {key: row[key] for key in ("name", "section") if key in row}
        unused = [key for key in row.keys() - own.keys() if f'"<={key}>"' not in json.dumps(steps)]
        assert not unused, f"{row['name']}: no step has {unused}"
        yield {**shared, **own, "steps": _filled(steps, {**(default or {}), **row})}


def _filled(part: Any, values: dict[str, Any]) -> Any:
    """Return a part of a family's steps with the values of a row."""
    if isinstance(part, list):
        return [_filled(each, values) for each in part]
    if isinstance(part, dict):
        return {key: _filled(value, values) for key, value in part.items() if _name(value) in (None, *values)}
    return part if (name := _name(part)) is None else values[name]


def _name(part: Any) -> str | None:
    """Return the name of the value that a part of a step stands for."""
    is_named = isinstance(part, str) and part.startswith(VALUE[0])
    return part.removeprefix(VALUE[0]).removesuffix(VALUE[1]) if is_named else None


def covering_cases(suits: Callable[[dict[str, Any]], bool] = lambda _case: True) -> list[dict[str, Any]]:
    """Return cases that have, together, every feature of all suitable cases that let no time pass.

    Each time the case with the most features that no chosen one has is added.
    """
    features = {case["name"]: set(features_of(case)) for case in cases() if suits(case) and not lets_time_pass(case)}
    left, chosen = set[str]().union(*features.values()), set[str]()
    while left:
        best = max(features, key=lambda name: len(features[name] & left))
        chosen.add(best)
        left -= features[best]
    return [case for case in cases() if case["name"] in chosen]


def lets_time_pass(case: dict[str, Any]) -> bool:
    return any("advance_ms" in step for step in case["steps"])


def features_of(case: dict[str, Any]) -> Iterator[str]:
    """Go over the options of a case, kinds of frames, operations, control fields, and sentences of refusals."""
    yield from case.keys() - {"name", "section", "steps"}
    for step in case["steps"]:
        for key, content in step.items():
            if key in ("client", "pieces", "advance_ms"):
                continue
            for each in content if isinstance(content, list) else [content]:
                operation = each if isinstance(each, dict) else {}
                yield f"{key} {operation.get('op')}"
                yield from (f"{field} in {key}" for field in operation)
                yield from (f"{name} {operation[name]}" for name in ("compression", "level") if name in operation)
                for sentence in (operation.get("msg"), operation.get("values")):
                    if isinstance(sentence, str):
                        # Names, numbers and what was got differ within a class of errors.
                        yield re.sub(r"/\w+|\d+|'.*?'|\(.*?\)", "", sentence)


async def play(case: dict[str, Any], player: Player) -> None:
    """Play a case; an assertion names the step that went otherwise."""
    for number, step in enumerate(case["steps"]):
        where = f"step {number} {step}"
        if "advance_ms" in step:
            await player.advance(step["advance_ms"] / 1000)
        elif "close" in step:
            await player.close(step["client"])
        elif "expect_nothing" in step:
            assert await player.nothing_comes(step["client"]), where
        elif any(key.startswith("expect") for key in step):
            await expect(step, player, where)
        else:
            await player.send(step["client"], frame_of(step))


async def expect(step: dict[str, Any], player: Player, where: str) -> None:
    """See that what comes next is what the step says."""

    async def next_frame() -> str | bytes:
        frame = await player.next_frame(step["client"])
        assert frame is not None, f"{where}: nothing came"
        return frame

    async def next_object() -> Any:
        frame = await next_frame()
        assert isinstance(frame, str), f"{where}: a binary frame came"
        return json.loads(frame)

    if "expect" in step:
        assert_matches(step["expect"], await next_object(), where)
    elif "expect_any_order" in step:
        left = [await next_object() for _ in step["expect_any_order"]]
        for wanted in step["expect_any_order"]:
            left.remove(next(got for got in left if matches(wanted, got)))
    elif "expect_png" in step:
        packed = await next_object()
        assert list(packed) == ["op", "data"], where
        assert_matches(step["expect_png"], json.loads(png.decode(packed["data"])), where)
    elif "expect_fragments" in step:
        pieces = [await next_object() for _ in range(step["pieces"])]
        assert [(piece["num"], piece["total"]) for piece in pieces] == [(n, len(pieces)) for n in range(len(pieces))]
        assert {(piece["op"], piece["id"]) for piece in pieces} == {("fragment", pieces[0]["id"])}, where
        assert_matches(step["expect_fragments"], json.loads("".join(piece["data"] for piece in pieces)), where)
    else:
        key, decode = ("expect_bson", bson.decode) if "expect_bson" in step else ("expect_cbor", cbor2.loads)
        frame = await next_frame()
        assert isinstance(frame, bytes), f"{where}: a text frame came"
        assert_matches(step[key], decode(frame), where)


def frame_of(step: dict[str, Any]) -> str | bytes:
    """The frame of a step that sends one."""
    if "send_text" in step:
        return str(step["send_text"])
    if "send_binary" in step:
        return str(step["send_binary"]).encode()
    if "send_hex" in step:
        return bytes.fromhex(step["send_hex"])
    return bson.encode(step["send_bson"]) if "send_bson" in step else json.dumps(step["send"])


def matches(wanted: Any, got: Any) -> bool:
    """Return true if :func:`assert_matches` passes."""
    try:
        assert_matches(wanted, got, "")
    except AssertionError:
        return False
    return True


def assert_matches(wanted: Any, got: Any, where: str) -> None:
    """Equal, with the keys in the same order, but for what may be any."""
    if wanted == ANY:
        return
    if isinstance(wanted, str) and wanted.startswith(CONTAINS[0]):
        words = wanted.removeprefix(CONTAINS[0]).removesuffix(CONTAINS[1])
        assert words in got, f"{where}: got {got!r}"
    elif isinstance(wanted, str) and wanted.startswith(BYTES[0]):
        assert got == bytes.fromhex(wanted.removeprefix(BYTES[0]).removesuffix(BYTES[1])), f"{where}: got {got!r}"
    elif isinstance(wanted, dict) and isinstance(got, dict):
        assert list(got) == list(wanted), where
        for key, value in wanted.items():
            assert_matches(value, got[key], f"{where} at {key}")
    elif isinstance(wanted, list) and isinstance(got, list):
        assert len(got) == len(wanted), where
        for index, value in enumerate(wanted):
            assert_matches(value, got[index], f"{where} at {index}")
    else:
        assert got == wanted, f"{where}: got {got!r}"
        assert type(got) is type(wanted), where
