import logging
import re
from pathlib import Path

import pytest

from harness.server import ROOT
from protocol.registry import Registry
from server.interfaces import OWN_PACKAGES, load_registry
from tests.conformance.cases import INTERFACES

# A type's name in a text: `geometry_msgs/Point`, `moveit_msgs/msg/RobotState`.
TYPE_NAME = re.compile(r"[\"'`]([a-z][a-z0-9_]*)/(?:(msg|srv|action)/)?([A-Z]\w*)[\"'`]")


def packages_of(registry: Registry, name: str) -> set[str]:
    """Packages of a type and of all that it contains."""
    canonical = [f"{name}{member}" for member in ("", "_Request", "_Response", "_Goal", "_Result", "_Feedback")]
    waiting = [each for each in canonical if registry.knows(each)]
    found = {name.split("/")[0]}
    while waiting:
        message = registry.message(waiting.pop())
        found.add(message.name.split("/")[0])
        waiting += [field.base for field in message.fields if not field.primitive]
    return found


def test_no_type_that_the_server_names_in_its_source_can_be_replaced() -> None:
    registry, found = Registry.load(), set()
    for path in [*(ROOT / "server").rglob("*.py"), *(ROOT / "protocol").rglob("*.py")]:
        for package, kind, name in TYPE_NAME.findall(path.read_text()):
            for each in (kind,) if kind else ("msg", "srv", "action"):
                canonical = f"{package}/{each}/{name}"
                if registry.knows(canonical, each):
                    found |= packages_of(registry, canonical)
    assert len(found) > 15
    assert found - OWN_PACKAGES == set()


def test_the_types_of_the_users_packages_are_known_and_told(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        registry = load_registry([INTERFACES / "lab_msgs", INTERFACES / "robots"])
    assert registry.knows("lab_msgs/Sample")
    assert registry.knows("old_lab_msgs/Reading")
    assert "interfaces of 2 packages read: lab_msgs, old_lab_msgs; 13 types added" in caplog.text
    assert set(load_registry([]).type_names()) == set(Registry.load().type_names())


def test_a_differing_type_of_the_server_stays_and_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    for name in ("sensor_msgs/msg/JointState", "turtlesim/msg/Color"):
        path = tmp_path / f"{name}.msg"
        path.parent.mkdir(parents=True)
        path.write_text("int32 something_else\n")
    with caplog.at_level(logging.INFO):
        registry = load_registry([tmp_path])
    assert [field.name for field in registry.message("sensor_msgs/JointState").fields][1] == "name"
    assert [(record.levelname, record.args) for record in caplog.records[1:]] == [
        ("INFO", (1, "turtlesim/msg/Color")),
        ("WARNING", (1, "sensor_msgs/msg/JointState")),
    ]
