import argparse
import errno
import re
from collections.abc import Iterator

import pytest
from pydantic import Field

from robot.errors import PortBusy, PortError
from server import cli
from server.commands.options import guarded, overrides, read_settings
from server.commands.terminal import ExitCode
from server.config import Settings
from server.config_keys import SettingsSection, template
from server.errors import ConfigurationError


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


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        (
            ("--port", "0", "--serial", "auto", "--log-level", "error"),
            {"server": {"port": "0", "log_level": "error"}, "arm": {"serial": "auto"}},
        ),
        (("--record", "run.mcap", "--record-limit-mb", "2"), {"recording": {"file": "run.mcap", "limit_mb": "2"}}),
        (("--interfaces", "a_msgs", "--interfaces", "ws/src"), {"server": {"interfaces": ["a_msgs", "ws/src"]}}),
        # An option counts more than an assignment, which may be a table as TOML has it.
        (("--set", "server.port=1", "--port", "2"), {"server": {"port": "2"}}),
        (("--set", "arm.zero_offset_rad={elbow_flex=0.02}"), {"arm": {"zero_offset_rad": {"elbow_flex": 0.02}}}),
    ],
)
def test_options_override_settings(arguments, settings):
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


@pytest.mark.parametrize(
    ("command", "option", "value", "words"),
    [
        ("camera test", "--connect", "http://x", "must begin with ws:// or wss://, not 'http://x'"),
        ("camera test", "--fps", "0", "must be a whole number from 1 to 60, not '0'"),
        ("camera test", "--width", "9", "must be a whole number from 16 to 4096, not '9'"),
        ("camera test", "--quality", "96", "must be a whole number from 1 to 95, not '96'"),
        ("replay run.mcap", "--rate", "fast", "must be 0.01 to 100, not 'fast'"),
        ("replay run.mcap", "--delay", "-1", "must be 0 to 3600, not '-1'"),
    ],
)
def test_an_option_out_of_range_is_refused_with_the_range(command, option, value, words, capsys):
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--set", "server.port"), "--set server.port: must be KEY=VALUE"),
        (("--set", "arm.zero_offset_rad={a"), "the value is not TOML"),
        (("--set", "server=1", "--set", "server.port=2"), "--set server.port: server has a value already"),
        (("--set", "server=1", "--port", "2"), "--set server.port: server has a value already"),
    ],
)
def test_a_wrong_assignment_is_refused(arguments, words):
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
