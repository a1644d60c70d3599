"""Conformance cases: what clients send and what must come back, as data.

A case is ``{"name", "section", "steps"}``. A step is one of ``{"client", "send": object}``, ``{"client", "send_text":
text}``, ``{"client", "send_binary": text}``, ``{"client", "expect": object}`` (the client's next frame, equal to the
letter and in the order of its keys; ``"<any>"`` stands for any value), ``{"client", "expect_nothing": true}``,
``{"client", "close": true}`` and ``{"advance_ms": number}``. A client connects with its first step; every case starts
with a fresh server.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

FOLDER = Path(__file__).parents[1] / "conformance"

ANY = "<any>"


class Player(Protocol):
    """Plays steps on some server."""

    async def send(self, client: str, frame: str | bytes) -> None: ...
    async def next_frame(self, client: str) -> bytes | str | None: ...
    async def close(self, client: str) -> None: ...
    async def advance(self, seconds: float) -> None: ...


def cases() -> list[dict[str, Any]]:
    """Every case of every file."""
    return [case for path in sorted(FOLDER.glob("*.json")) for case in json.loads(path.read_text())]


async def play(case: dict[str, Any], player: Player) -> None:
    """Play a case; an assertion names the step that went otherwise."""
    for number, step in enumerate(case["steps"]):
        where = f"step {number} {step}"
        if "advance_ms" in step:
            await player.advance(step["advance_ms"] / 1000)
            continue
        client = step["client"]
        if "expect" in step:
            frame = await player.next_frame(client)
            assert frame is not None, f"{where}: nothing came"
            assert_matches(step["expect"], json.loads(frame), where)
        elif "expect_nothing" in step:
            assert await player.next_frame(client) is None, where
        elif "close" in step:
            await player.close(client)
        else:
            await player.send(client, _frame(step))


def _frame(step: dict[str, Any]) -> str | bytes:
    if "send_text" in step:
        return str(step["send_text"])
    if "send_binary" in step:
        return str(step["send_binary"]).encode()
    return json.dumps(step["send"])


def assert_matches(wanted: Any, got: Any, where: str) -> None:
    """Equal, with the keys in the same order, but for what may be any."""
    if wanted == ANY:
        return
    if isinstance(wanted, dict) and isinstance(got, dict):
        assert list(got) == list(wanted), where
        for key, value in wanted.items():
            assert_matches(value, got[key], f"{where} at {key}")
    elif isinstance(wanted, list) and isinstance(got, list):
        assert len(got) == len(wanted), where
        for index, value in enumerate(wanted):
            assert_matches(value, got[index], f"{where} at {index}")
    else:
        assert got == wanted, where
        assert type(got) is type(wanted), where
