"""ARCHITECTURE.md: each of its examples is added to a server as the page describes, and called by a client."""

import inspect
import re
import sys
import textwrap
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

import protocol.operations
import server.gateway.client
from harness.server import ROOT
from robot.messages import ArmState, Mode
from server.app import App
from server.config import Settings
from server.lifecycle import Feature
from tests.helpers.gateway import InProcess
from tests.helpers.rules import started

PAGE = (ROOT / "ARCHITECTURE.md").read_text()
BLOCKS = dict(re.findall(r"```python\n# (\S+)\n(.*?)```", PAGE, re.DOTALL))


def feature(path: str, app: App, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Make the one feature of a block, as a module of its own."""
    module = ModuleType(path.removesuffix(".py").replace("/", "."))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(BLOCKS[path], path, "exec"), vars(module))
    (found,) = (
        each
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Feature) and each is not Feature
    )
    return found(app._context)


def called(app: App, service: str) -> dict[str, Any]:
    """Return the values of a service's response to a client."""
    world = InProcess()
    world._gateway = replace(world._gateway, graph=app.graph, access=app._context.access)
    world.say("client", op="call_service", service=service, id="1")
    (response,) = world.heard("client")
    values: dict[str, Any] = response["values"]
    return values


async def test_the_service_answers_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    app = await started(Settings())
    feature("server/features/greeting.py", app, monkeypatch)
    assert called(app, "/greeting/greet") == {"success": True, "message": "hello"}


async def test_the_arm_feature_serves_one_arm_and_each_of_several(monkeypatch: pytest.MonkeyPatch) -> None:
    for arms, names in (((), [""]), (("left", "right"), ["left", "right", ""])):
        app = await started(Settings.model_validate({"arms": {name: {} for name in arms}}))
        made = feature("server/features/whereabouts.py", app, monkeypatch)
        for name in names:
            prefix = f"/{name}" if name else ""
            assert not called(app, f"{prefix}/arm/where")["success"]
            made.on_state(name, ArmState(0.0, Mode.HOLDING, ()))
            assert called(app, f"{prefix}/arm/where") == {"success": True, "message": "holding"}


def test_the_operation_is_answered_and_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    operations, client = protocol.operations, server.gateway.client
    known = vars(operations) | vars(client)
    exec(BLOCKS["protocol/operations.py"], known)
    monkeypatch.setitem(operations.OPERATIONS, "ping", known["Ping"])
    monkeypatch.setattr(operations, "Ping", known["Ping"], raising=False)
    exec(textwrap.dedent(inspect.getsource(client.Client._serve) + BLOCKS["server/gateway/client.py"]), known)
    monkeypatch.setattr(client.Client, "_serve", known["_serve"])
    world = InProcess()
    world.say("client", op="set_level", level="info")
    world.heard("client")
    world.say("client", op="ping", text="once", id="7")
    world.say("client", op="ping", text=7)
    answer, refusal = world.heard("client")
    assert (answer["level"], answer["id"]) == ("info", "7")
    assert "pong once" in answer["msg"]
    assert "text: wanted text, got" in refusal["msg"]
