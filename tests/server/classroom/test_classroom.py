from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from server.classroom.classroom import run_classroom
from server.config import Settings
from server.errors import ConfigurationError


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"arm": {"serial": "/dev/ttyACM0"}}, "arm.serial: the arms of a classroom are simulated"),
        ({"emulator": {"control": "/tmp/servos"}}, "emulator.control: the arms of a classroom are simulated"),
        ({"emulator": {"write_log": "/tmp/writes"}}, "emulator.write_log: the arms of a classroom are simulated"),
        ({"zenoh": {"mode": "peer"}}, "zenoh.mode: must be off in a classroom, not peer"),
        ({"server": {"tcp_port": 9091}}, "server.tcp_port: the servers of a classroom have one port each"),
        ({"arm": {"robot": "no such arm"}}, "no such arm"),
        ({"server": {"port": 65_535}}, "there are none above 65535"),
    ],
)
def test_a_bad_classroom_is_refused_before_it_is_made(settings: dict[str, Any], sentence: str, tmp_path: Path) -> None:
    folder = tmp_path / "class"
    with pytest.raises(ConfigurationError, match=sentence):
        run_classroom(Settings.model_validate(settings), 2, 2, folder)
    assert not folder.exists()
