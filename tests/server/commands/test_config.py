import configparser
import json
import shutil
import sys
from pathlib import Path

import pytest

from server import cli
from server.commands.config import server_command, unit
from server.commands.terminal import ExitCode
from tests.helpers.programs import run


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Settings from all four sources."""
    path = tmp_path / "armbridge.toml"
    path.write_text('[server]\nport = 1\nhost = "::1"\n[goals]\ncapacity = 3\n')
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    return path


def test_every_value_is_told_with_its_source_as_json_and_in_a_table(file, capsys):
    assert cli.main(["config", "--json", "--config", str(file), "--set", "goals.capacity=4"]) == ExitCode.DONE
    told = json.loads(capsys.readouterr().out)
    assert told["server.host"] == {"value": "::1", "source": "file"}
    assert told["server.port"] == {"value": 2, "source": "environment"}
    assert told["goals.capacity"] == {"value": 4, "source": "command line"}
    assert told["goals.confirm"] == {"value": False, "source": "default"}
    assert cli.main(["config", "--config", str(file)]) == ExitCode.DONE
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["server.port", "2", "environment"] in rows
    assert ["arm.watchdog_s", "0.5", "s", "default"] in rows
    assert ["arm.serial", "-", "default"] in rows
    assert cli.main(["config", "--template"]) == ExitCode.DONE
    assert "[moveit.servo]" in capsys.readouterr().out


@pytest.mark.parametrize("form", [[], ["--json"]])
def test_tokens_are_told_to_be_set_and_not_shown(form, capsys, monkeypatch):
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "one-0123456789abcdef")
    table = 'access.view_tokens={screen="two-0123456789abcdef"}'
    assert cli.main(["config", *form, "--set", table]) == ExitCode.DONE
    told = capsys.readouterr().out
    assert told.count("**********") == 2
    assert "screen" in told
    assert "0123456789abcdef" not in told


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


def test_a_unit_has_the_user_and_group_that_are_given_and_quotes_what_systemd_would_read_otherwise() -> None:
    text = unit(["/opt/my arm/bin/armbridge"], Path('/etc/100% "$HOME".toml'), "lab", "uucp")
    service = section(text, "Service")
    assert (service["User"], service["SupplementaryGroups"]) == ("lab", "uucp")
    assert "DynamicUser" not in service
    assert service["ExecStart"] == '"/opt/my arm/bin/armbridge" serve --config "/etc/100%% \\"$$HOME\\".toml"'


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
    done = run("systemd-analyze", "verify", "--man=no", file)
    assert (done.returncode, done.stderr) == (0, "")
