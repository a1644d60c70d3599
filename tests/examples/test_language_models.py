"""The dialogues of the page about language models: each call gets the answer that the page shows."""

from __future__ import annotations

import json
from typing import Any

from websockets.sync.client import connect

from harness.server import ROOT, RunningServer
from tests.test_readme import blocks

ANSWER_TIMEOUT_S = 60.0


def differences(wanted: Any, got: Any, place: str = "result") -> list[str]:
    """Where an answer is not what the page shows; it may have more fields."""
    if isinstance(wanted, dict) and isinstance(got, dict):
        missing = [f"{place}.{key} is missing" for key in wanted if key not in got]
        return missing + [
            text for key in wanted if key in got for text in differences(wanted[key], got[key], f"{place}.{key}")
        ]
    if isinstance(wanted, list) and isinstance(got, list) and len(wanted) == len(got):
        return [
            text for number, each in enumerate(wanted) for text in differences(each, got[number], f"{place}[{number}]")
        ]
    return [] if wanted == got else [f"{place}: the page shows {wanted!r}, the server answered {got!r}"]


def test_every_call_of_the_dialogues_gets_the_answer_that_the_page_shows(server: RunningServer) -> None:
    lines = [
        json.loads(line)
        for block in blocks(ROOT / "docs" / "language-models.md", "json")
        for line in block.splitlines()
    ]
    dialogues = lines[next(number for number, line in enumerate(lines) if "tool" in line) :]
    wrong = []
    with connect(server.url) as client:
        for request, answer in zip(dialogues[::2], dialogues[1::2], strict=True):
            assert request["tool"] == "call_service"
            call = request["arguments"]
            fields = {"service": call["service_name"], "type": call["service_type"], "args": call["request"]}
            client.send(json.dumps({"op": "call_service", **fields}))
            values = json.loads(client.recv(timeout=ANSWER_TIMEOUT_S))["values"]
            wrong += differences(answer, values, json.dumps(call["request"]))
    assert len(dialogues) > 10
    assert wrong == []
