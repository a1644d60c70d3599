import logging
from pathlib import Path

import pytest

from protocol.registry import Registry
from server.interfaces import load_registry
from tests.conformance.cases import INTERFACES


def test_types_of_users_packages_are_known_and_others_stay(caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    with caplog.at_level(logging.INFO):
        registry = load_registry([INTERFACES / "lab_msgs", INTERFACES / "robots"])
    assert registry.knows("lab_msgs/Sample")
    assert registry.knows("old_lab_msgs/Reading")
    assert "interfaces of 2 packages read: lab_msgs, old_lab_msgs; 13 types added" in caplog.text
    assert set(load_registry([]).type_names()) == set(Registry.load().type_names())
    path = tmp_path / "sensor_msgs" / "msg" / "JointState.msg"
    path.parent.mkdir(parents=True)
    path.write_text("int32 something_else\n")
    with caplog.at_level(logging.INFO):
        registry = load_registry([tmp_path])
    assert [field.name for field in registry.message("sensor_msgs/JointState").fields][1] == "name"
    assert "1 types of these packages stay as armbridge has them: sensor_msgs/msg/JointState" in caplog.text
