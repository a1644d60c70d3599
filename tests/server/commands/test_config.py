"""Commands about settings: options, configuration and certificate."""

import argparse
import configparser
import errno
import re
import shutil
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import Field

from harness.server import ROOT
from robot.errors import PortBusy, PortError
from robot.files import FileLock, FileLockedError, replace
from server import cli
from server.access.authentication import Tokens
from server.access.settings import AccessSettings
from server.commands import certificate
from server.commands.certificate import ensure_token
from server.commands.config import server_command, unit
from server.commands.options import guarded, overrides, read_settings
from server.commands.terminal import ExitCode
from server.config import Settings
from server.config_keys import SettingsSection, template
from server.errors import ConfigurationError
from server.graph.permissions import Role
from tests.helpers.programs import run


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (PortError("/dev/x", "does not exist"), "does not exist"),
        (PortBusy("/dev/x"), "armbridge serve"),
        (KeyboardInterrupt(), "stop"),
        (OSError(errno.ENOSPC, "No space left on device"), "armbridge: No space left on device"),
        (OSError(errno.ENAMETOOLONG, "File name too long", "/x"), "armbridge: /x: File name too long"),
    ],
)
def test_an_error_of_a_command_is_one_line_and_exit_1(error, words, capsys):
    def command(_terminal):
        raise error

    assert guarded(command) is ExitCode.FAILED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


@pytest.mark.parametrize("error", [ZeroDivisionError, BrokenPipeError])
def test_a_mistake_in_a_command_and_the_end_of_its_reader_are_not_hidden(error):
    def command(_terminal):
        raise error

    with pytest.raises(error):
        guarded(command)


def options(*arguments):
    return cli._parser().parse_args(["serve", *arguments])


def test_options_override_settings():
    for arguments, settings in (
        (
            ("--port", "0", "--serial", "auto", "--log-level", "error"),
            {"server": {"port": "0", "log_level": "error"}, "arm": {"serial": "auto"}},
        ),
        (("--record", "run.mcap", "--record-limit-mb", "2"), {"recording": {"file": "run.mcap", "limit_mb": "2"}}),
        (("--interfaces", "a_msgs", "--interfaces", "ws/src"), {"server": {"interfaces": ["a_msgs", "ws/src"]}}),
        # An option counts more than an assignment, which may be a table as TOML has it.
        (("--set", "server.port=1", "--port", "2"), {"server": {"port": "2"}}),
        (
            ("--set", 'goals.policy="reject"', "--set", "server.host='::1'"),
            {"goals": {"policy": "reject"}, "server": {"host": "::1"}},
        ),
        (("--set", "arm.zero_offset_rad={elbow_flex=0.02}"), {"arm": {"zero_offset_rad": {"elbow_flex": 0.02}}}),
    ):
        assert overrides(options(*arguments)) == settings


def test_settings_have_what_the_options_say_and_know_it_from_the_command_line():
    assigned = ("--set", "moveit.servo.rate_hz=30", "--set", "goals.confirm = true")
    settings, sources = read_settings(options("--insecure", *assigned))
    assert (settings.access.insecure, settings.moveit.servo.rate_hz, settings.goals.confirm) == (True, 30.0, True)
    assert sources["access.insecure"] == "command line"
    assert read_settings(options())[0].access.insecure is False


def test_a_new_setting_is_explained_everywhere_by_its_one_line(monkeypatch, capsys):
    class Section(SettingsSection):
        """Section of a test."""

        retry_s: float = Field(default=2.0, ge=1, le=5)
        """time between two attempts; None for no attempt [s]."""

    class WithSection(Settings):
        section: Section = Section()

    text = template(WithSection)
    assert "# Section of a test.\n[section]\n# Time between two attempts; leave it out for no attempt." in text
    assert " (s, 1 to 5)\nretry_s = 2.0\n" in text
    monkeypatch.setattr("server.commands.options.Settings", WithSection)
    monkeypatch.setattr("server.commands.options._FURTHER_OPTIONS", (("--retry", "section.retry_s", "S"),))
    with pytest.raises(SystemExit):
        options("--help")
    shown = " ".join(capsys.readouterr().out.split())
    assert "--retry S Time between two attempts; leave it out for no attempt. (s, 1 to 5) Default: 2.0." in shown


def test_an_option_out_of_range_is_refused_with_the_range(capsys):
    for command, option, value, words in (
        ("camera test", "--connect", "http://x", "must begin with ws:// or wss://, not 'http://x'"),
        ("camera test", "--fps", "0", "must be a whole number from 1 to 60, not '0'"),
        ("camera test", "--width", "9", "must be a whole number from 16 to 4096, not '9'"),
        ("camera test", "--quality", "96", "must be a whole number from 1 to 95, not '96'"),
    ):
        with pytest.raises(SystemExit, match=str(int(ExitCode.USAGE))):
            cli.main([*command.split(), option, value])
        assert f"argument {option}: {words}" in capsys.readouterr().err


@pytest.mark.parametrize(
    "assignment",
    ["access.token:my-secret", "access.view_tokens={a=my-secret", "access.token=my-secret", "access=my-secret"],
)
def test_a_refusal_does_not_show_what_may_be_a_token(assignment):
    with pytest.raises(ConfigurationError) as refused:
        read_settings(options("--set", assignment))
    assert "my-secret" not in str(refused.value)


def test_a_wrong_assignment_is_refused():
    for arguments, words in (
        (("--set", "server.port"), "--set server.port: must be KEY=VALUE"),
        (("--set", "=3"), "--set : must be KEY=VALUE"),
        (("--set", "arm.zero_offset_rad={a"), "the value is not TOML"),
        (("--set", "server=1", "--set", "server.port=2"), "--set server.port: server has a value already"),
        (("--set", "server=1", "--port", "2"), "--set server.port: server has a value already"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            overrides(options(*arguments))


def options_of(parser: argparse.ArgumentParser, command: str = "armbridge") -> Iterator[tuple[str, argparse.Action]]:
    """Every option of a command and of the commands in it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from options_of(inner, f"{command} {name}")
        else:
            yield command, action


def test_the_default_at_the_end_of_an_option_s_help_is_its_default():
    wrong = {}
    checked = 0
    for command, action in options_of(cli._parser()):
        shown = re.search(r"\((?:default )?([^() ]+)\)$", action.help or "")
        # Other defaults are those of settings, or words; a choice may be described at the end.
        if shown and not action.choices and action.default not in (None, []):
            checked += 1
            kind = float if isinstance(action.default, (int, float)) else str
            if kind(shown[1]) != kind(action.default):
                wrong[command, action.option_strings[-1]] = action.help, action.default
    assert checked > 20
    assert wrong == {}


def test_every_value_is_told_with_its_source(tmp_path, monkeypatch, capsys):
    file = tmp_path / "armbridge.toml"
    file.write_text('[server]\nport = 1\nhost = "::1"\n[goals]\ncapacity = 3\n')
    monkeypatch.setenv("ARMBRIDGE_SERVER__PORT", "2")
    assert cli.main(["config", "--config", str(file), "--set", "goals.capacity=4"]) == ExitCode.DONE
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["server.host", '"::1"', "file"] in rows
    assert ["server.port", "2", "environment"] in rows
    assert ["goals.capacity", "4", "command", "line"] in rows
    assert ["arm.watchdog_s", "0.5", "s", "default"] in rows
    assert ["arm.serial", "-", "default"] in rows
    assert cli.main(["config", "--template"]) == ExitCode.DONE
    assert "[moveit.servo]" in capsys.readouterr().out


def test_tokens_are_told_to_be_set_and_not_shown(capsys, monkeypatch):
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "one-0123456789abcdef")
    table = 'access.view_tokens={screen="two-0123456789abcdef"}'
    assert cli.main(["config", "--set", table]) == ExitCode.DONE
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


def test_a_unit_has_user_group_and_quotes_and_without_a_script_the_interpreter_runs_the_server(tmp_path: Path) -> None:
    text = unit(["/opt/my arm/bin/armbridge"], Path('/etc/100% "$HOME".toml'), "lab", "uucp")
    service = section(text, "Service")
    assert (service["User"], service["SupplementaryGroups"]) == ("lab", "uucp")
    assert "DynamicUser" not in service
    assert service["ExecStart"] == '"/opt/my arm/bin/armbridge" serve --config "/etc/100%% \\"$$HOME\\".toml"'
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


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return tmp_path / "armbridge" / "tls"


def test_authority_and_token_are_made_once_and_kept_for_their_owner_who_is_told_what_to_do(folder, capsys):
    tokens = folder / "tokens.toml"
    files = [folder / name for name in ("server.pem", "server.key", "armbridge-authority.crt")] + [tokens]
    assert cli.main(["certificate", "--name", "arm.example"]) == ExitCode.DONE
    told = capsys.readouterr().out
    settings = f"--set server.tls_certificate={files[0]}", f"--set access.token_file={tokens}"
    for words in (*map(str, files), *settings, "arm.example, localhost", "iPhone", "Android"):
        assert words in told
    # The page about phones shows the same command.
    page = (ROOT / "docs" / "page.md").read_text().replace("/home/me/.local/share/armbridge/tls", str(folder))
    command = told[told.index("  armbridge serve") :].split("\nA server")[0]
    assert "\n".join(line[2:] for line in command.splitlines()) in page.replace("\n    --", "\n  --")
    (token,) = re.findall(r"^  ([0-9a-f]{32})$", told, re.MULTILINE)
    assert stat.S_IMODE(tokens.stat().st_mode) == 0o600
    identity = Tokens.from_settings(AccessSettings(token_file=tokens)).identify(token)
    assert identity is not None
    assert (identity.name, identity.role) == ("owner", Role.ADMIN)
    kept = [file.read_bytes() for file in files[2:]]
    assert cli.main(["certificate"]) == ExitCode.DONE
    told = capsys.readouterr().out
    assert "armbridge-authority.crt (as before)" in told
    assert f"The tokens are in {tokens}, as before." in told
    assert token not in told
    assert [file.read_bytes() for file in files[2:]] == kept


def test_a_wrong_name_and_a_token_that_cannot_be_kept_are_one_sentence(folder, capsys):
    assert cli.main(["certificate", "--name", "a b"]) == ExitCode.FAILED
    assert capsys.readouterr().err == "armbridge: --name: 'a b' is neither a host name nor an IP address\n"
    assert not folder.exists()
    folder.mkdir(parents=True)
    (folder / "none").touch()
    with pytest.raises(ConfigurationError, match=r"tokens\.toml: the token cannot be kept there"):
        ensure_token(folder / "none")


def test_of_two_commands_at_a_time_one_makes_the_token(folder, monkeypatch):
    def replace_locked(path, content, mode):
        with pytest.raises(FileLockedError):
            FileLock(path).acquire(0.0)
        replace(path, content, mode)

    folder.mkdir(parents=True)
    monkeypatch.setattr(certificate, "replace", replace_locked)
    assert [bool(ensure_token(folder)[1]) for _ in range(2)] == [True, False]
