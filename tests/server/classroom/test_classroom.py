from pathlib import Path
from typing import Any

import pytest

from server.classroom.classroom import run_classroom
from server.config import Settings
from server.errors import ConfigurationError


@pytest.mark.parametrize(
    ("settings", "physics", "sentence"),
    [
        ({"arm": {"serial": "/dev/ttyACM0"}}, [], "arm.serial: the arms of a classroom are simulated"),
        ({"emulator": {"control": "/tmp/servos"}}, [], "emulator.control: the arms of a classroom are simulated"),
        ({"emulator": {"write_log": "/tmp/writes"}}, [], "emulator.write_log: the arms of a classroom are simulated"),
        ({"zenoh": {"mode": "peer"}}, [], "zenoh.mode: must be off in a classroom, not peer"),
        ({"server": {"tcp_port": 9091}}, [], "server.tcp_port: the servers of a classroom have one port each"),
        ({"arm": {"robot": "no such arm"}}, [], "no such arm"),
        ({"server": {"port": 65_535}}, [], "there are none above 65535"),
        ({}, ["student01", "student03"], "--physics: there is no 'student03': the students are student01 to student02"),
    ],
)
def test_a_bad_classroom_is_refused_before_it_is_made(
    settings: dict[str, Any], physics: list[str], sentence: str, tmp_path: Path
) -> None:
    folder = tmp_path / "class"
    with pytest.raises(ConfigurationError, match=sentence):
        run_classroom(Settings.model_validate(settings), 2, 2, folder, physics)
    assert not folder.exists()


def test_students_by_name_have_physics_and_the_others_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    served: list[str] = []
    module = "server.classroom.classroom"
    monkeypatch.setattr(f"{module}.serve", lambda settings, *_: served.append(settings.simulation.kind))
    monkeypatch.setattr(f"{module}.supervise", lambda members, _check: [member.run() for member in members[1:]])
    run_classroom(Settings.model_validate({"server": {"port": 0}}), 3, 2, tmp_path, ["student02"])
    assert served == ["light", "physics", "light"]
