from __future__ import annotations

import configparser
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from server import cli
from server.commands.systemd_unit import server_command, unit


def section(text: str, name: str) -> configparser.SectionProxy:
    parser = configparser.RawConfigParser(strict=False, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return parser[name]


def test_the_unit_runs_this_installation(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["systemd-unit", "--config", "/etc/armbridge/armbridge.toml"]) == 0
    service = section(capsys.readouterr().out, "Service")
    program, *words = service["ExecStart"].split()
    assert Path(program).is_file()
    assert words[-3:] == ["serve", "--config", "/etc/armbridge/armbridge.toml"]
    assert (service["Type"], service["DynamicUser"], service["SupplementaryGroups"]) == ("notify", "yes", "dialout")


def test_a_user_and_a_group_of_its_own_can_be_given() -> None:
    service = section(unit(["/a"], None, "lab", "uucp"), "Service")
    assert (service["User"], service["SupplementaryGroups"]) == ("lab", "uucp")
    assert "DynamicUser" not in service
    assert service["ExecStart"] == "/a serve"


def test_words_that_systemd_would_read_otherwise_are_quoted() -> None:
    text = unit(["/opt/my arm/bin/armbridge"], Path('/etc/100% "$HOME".toml'), None, "dialout")
    command = '"/opt/my arm/bin/armbridge" serve --config "/etc/100%% \\"$$HOME\\".toml"'
    assert section(text, "Service")["ExecStart"] == command


def test_without_a_script_the_interpreter_runs_the_server(tmp_path: Path) -> None:
    python = tmp_path / "python"
    assert server_command(python) == [str(python), "-P", "-m", "server.cli"]
    (tmp_path / "armbridge").touch()
    assert server_command(python) == [str(tmp_path / "armbridge")]


def test_systemd_has_nothing_to_say_against_it(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    file = tmp_path / "armbridge.service"
    file.write_text(unit(server_command(Path(sys.executable)), None, None, "dialout"))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(file)], capture_output=True, text=True, timeout=30, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
