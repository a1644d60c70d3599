from __future__ import annotations

import json

import pytest

from server import cli
from server.commands.terminal import ExitCode


@pytest.fixture
def file(tmp_path, monkeypatch):
    """Settings from all four sources."""
    path = tmp_path / "armbridge.toml"
    path.write_text('[server]\nport = 1\nhost = "::1"\n[goals]\ncapacity = 3\n')
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    return path


def test_every_value_is_told_with_its_source(file, capsys):
    assert cli.main(["config", "--json", "--config", str(file), "--set", "goals.capacity=4"]) == ExitCode.DONE
    told = json.loads(capsys.readouterr().out)
    assert told["server.host"] == {"value": "::1", "source": "file"}
    assert told["server.port"] == {"value": 2, "source": "environment"}
    assert told["goals.capacity"] == {"value": 4, "source": "command line"}
    assert told["goals.confirm"] == {"value": False, "source": "default"}


@pytest.mark.parametrize("form", [[], ["--json"]])
def test_tokens_are_told_to_be_set_and_not_shown(form, capsys, monkeypatch):
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "one-0123456789abcdef")
    table = 'access.view_tokens={screen="two-0123456789abcdef"}'
    assert cli.main(["config", *form, "--set", table]) == ExitCode.DONE
    told = capsys.readouterr().out
    assert told.count("**********") == 2
    assert "screen" in told
    assert "0123456789abcdef" not in told


def test_the_table_has_a_line_a_setting(file, capsys):
    assert cli.main(["config", "--config", str(file)]) == ExitCode.DONE
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["server.port", "2", "environment"] in rows
    assert ["arm.watchdog_s", "0.5", "s", "default"] in rows
    assert ["arm.serial", "-", "default"] in rows


def test_the_template_is_printed(capsys):
    assert cli.main(["config", "--template"]) == ExitCode.DONE
    assert "[moveit.servo]" in capsys.readouterr().out


def test_a_wrong_setting_is_one_line_and_exit_2(capsys):
    assert cli.main(["config", "--set", "moveit.plannr_id=PRM"]) == ExitCode.USAGE
    assert capsys.readouterr().err == "armbridge: moveit.plannr_id: unknown; did you mean planner_id?\n"
