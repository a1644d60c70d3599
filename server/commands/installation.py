"""Commands about the installation: ``armbridge config``, ``systemd-unit``, ``certificate`` and ``report``."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import secrets
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot.description import robot_folder
from robot.errors import NoReply
from robot.files import locked, replace
from robot.hardware.boards import resolve_port
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server.arm.setup import DEFAULT_ROBOT, Description
from server.commands.arm import as_json, examine_bus
from server.commands.options import Subparsers, add_command, add_setting_options, read_settings
from server.commands.terminal import ExitCode, Terminal, table
from server.config import PREFIX, Settings
from server.config_keys import Setting, every_setting, template, toml_value
from server.errors import ConfigurationError

if TYPE_CHECKING:
    from server.access.certificates import CertificateFiles, Outcome
    from server.monitoring.report import Report


def add_config_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "config",
        _config,
        "print every setting with its value and its source, or a configuration file to begin with",
        "Print the settings that armbridge serve would have with the same options and environment, and "
        "who has set each: default, file, environment or command line.",
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print them as a JSON object, by key")
    form.add_argument(
        "--template", action="store_true", help="print a TOML file with every setting explained, at its default"
    )
    add_setting_options(parser)


def _config(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    if options.template:
        terminal.tell(template(Settings).rstrip("\n"))
        return ExitCode.DONE
    settings, sources = read_settings(options)
    values = list(_effective(settings, sources))
    terminal.tell(_as_json(values) if options.json else _as_table(values))
    return ExitCode.DONE


def _effective(settings: Settings, sources: dict[str, str]) -> Iterator[tuple[Setting, Any, str]]:
    dumped = settings.model_dump(mode="json")
    for setting in every_setting(Settings):
        value: Any = dumped
        for part in setting.key.split("."):
            value = value[part]
        yield setting, value, sources.get(setting.key, "default")


def _as_json(values: list[tuple[Setting, Any, str]]) -> str:
    return json.dumps({setting.key: {"value": value, "source": source} for setting, value, source in values}, indent=2)


def _as_table(values: list[tuple[Setting, Any, str]]) -> str:
    rows = [
        (setting.key, "-" if value is None else toml_value(value), setting.unit, source)
        for setting, value, source in values
    ]
    return table(("setting", "value", "unit", "source"), rows)


# The arm process brakes, relaxes if it is to, and ends within 5.5 s of the server's death; to park the arm takes up to
# 15 s more, and is waited for. Then it may be killed.
_AFTER_DEATH_S = 6
_PARKING_S = 15

# Words that need no quotes.
_PLAIN = re.compile(r"[A-Za-z0-9_@/.+=:,-]+")

# Template of the unit: braces that stay are doubled.
_UNIT = Path(__file__).with_name("armbridge.service")


def add_systemd_unit_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "systemd-unit",
        _systemd_unit,
        "print a systemd unit that runs the server as a service",
        "Print a systemd unit for this installation: armbridge systemd-unit > armbridge.service.",
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="settings in TOML, for the service to read")
    parser.add_argument("--user", metavar="NAME", help="run as this user (made up by systemd)")
    parser.add_argument("--group", metavar="NAME", default="dialout", help="that serial ports belong to (dialout)")


def _systemd_unit(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    command = server_command(Path(sys.executable))
    terminal.tell(unit(command, options.config, options.user, options.group).rstrip())
    return ExitCode.DONE


def server_command(python: Path) -> list[str]:
    script = python.parent / "armbridge"
    return [str(script)] if script.is_file() else [str(python), "-P", "-m", "server.cli"]


def unit(command: list[str], config: Path | None, user: str | None, group: str) -> str:
    words = [*command, "serve", *([] if config is None else ["--config", str(config.absolute())])]
    return _UNIT.read_text().format(
        command=" ".join(_quoted(word) for word in words),
        after_death_s=_AFTER_DEATH_S,
        parking_s=_PARKING_S,
        usage=int(ExitCode.USAGE),
        user="DynamicUser=yes" if user is None else f"User={user}",
        group=group,
    )


def _quoted(word: str) -> str:
    """A word of a command line as systemd reads it (systemd.service, systemd.syntax)."""
    escaped = word.replace("%", "%%").replace("$", "$$").replace("\\", "\\\\").replace('"', '\\"')
    return escaped if _PLAIN.fullmatch(escaped) else f'"{escaped}"'


_PHONES = """\
Bring {authority} onto each phone, once.
iPhone, iPad:
  1. Send the file by AirDrop or mail, and open it: "Profile Downloaded".
  2. Settings > General > VPN & Device Management > {common_name} > Install.
  3. Settings > General > About > Certificate Trust Settings: switch it on.
Android:
  1. Copy the file to the phone, by cable or mail.
  2. Settings > Security > Encryption & credentials > Install a certificate > CA certificate. The
     words differ from phone to phone: search the settings for "CA certificate".
  3. Choose the file. Chrome trusts it from then on.
Compare the fingerprint that the phone shows (SHA-256):
  {fingerprint}
Keep {authority_key} to yourself: anybody who has it can
pretend to be any website to these phones. Remove the authority from a phone that is no longer used."""


# The file of the setting access.token_file, and the name of the one whose token is made.
TOKEN_FILE, OWNER = "tokens.toml", "owner"
TABLES = "[admin_tokens], [operate_tokens], [propose_tokens], [view_tokens]"
FILE_HEADER = f"Tokens of clients, by name: {TABLES}; see docs/security.md."
TOKEN_BYTES = 16


def add_certificate_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "certificate",
        _certificate,
        "make a certificate for this machine that phones and browsers accept (https)",
        "Make a local certificate authority, once, and a certificate of it for the names and addresses of "
        "this machine, and say how the server and a phone take them. The first time, make a token as well. "
        "Called again it renews the certificate when it "
        "is about to end or when names or addresses are missing. Nothing is sent anywhere.",
    )
    parser.add_argument(
        "--name",
        action="append",
        default=[],
        metavar="NAME_OR_ADDRESS",
        dest="names",
        help="one more host name or IP address by which phones reach the server; may be repeated",
    )
    parser.add_argument(
        "--directory", type=Path, metavar="FOLDER", help="where the files are kept (tls in the data folder)"
    )


def _certificate(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.access.certificates import CertificateFiles, ensure_certificate
    from server.gateway.admission import host_addresses, own_names
    from server.moveit.named_states import data_directory

    directory = options.directory or data_directory(os.environ) / "tls"
    files = CertificateFiles(directory.absolute())
    own = ("localhost", *reversed(own_names()), *host_addresses(), "127.0.0.1", "::1")
    try:
        outcome = ensure_certificate(files, (*options.names, *own))
        tokens, token = ensure_token(files.directory)
    except ConfigurationError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.FAILED
    terminal.tell(description_of(files, outcome, tokens, token))
    return ExitCode.DONE


def ensure_token(directory: Path) -> tuple[Path, str]:
    """Make a file of tokens with one in it, if there is none."""
    file, token = directory / TOKEN_FILE, secrets.token_hex(TOKEN_BYTES)
    try:
        with locked(file):
            if file.exists():
                return file, ""
            replace(file, f'# {FILE_HEADER}\n[admin_tokens]\n{OWNER} = "{token}"\n'.encode(), 0o600)
    except OSError as error:
        raise ConfigurationError(f"{file}: the token cannot be kept there: {error}") from error
    return file, token


def description_of(files: CertificateFiles, outcome: Outcome, tokens: Path, token: str) -> str:
    certificate = f"The certificate is valid until {outcome.ends:%Y-%m-%d}"
    made = f"{certificate}; it was made because {outcome.reason}." if outcome.reason else f"{certificate}; it stays."
    known = "" if outcome.made_authority else " Phones that trust it already need nothing."
    return "\n".join(
        (
            made,
            f"  certificate  {files.certificate}",
            f"  its key      {files.key}",
            f"  authority    {files.authority} ({'new' if outcome.made_authority else 'as before'}).{known}",
            f"  names        {', '.join(outcome.names)}",
            "",
            *_about_token(tokens, token),
            "",
            "Start the server with both, for other machines:",
            "  armbridge serve --host 0.0.0.0 \\",
            f"    --set access.token_file={tokens} \\",
            f"    --set server.tls_certificate={files.certificate} \\",
            f"    --set server.tls_key={files.key}",
            "A server that runs with it takes a renewed one on SIGHUP (systemctl reload armbridge).",
            "",
            _PHONES.format(
                authority=files.authority,
                authority_key=files.authority_key,
                common_name=outcome.authority_name,
                fingerprint=outcome.fingerprint,
            ),
        )
    )


def _about_token(file: Path, token: str) -> tuple[str, ...]:
    if not token:
        return (f"The tokens are in {file}, as before.",)
    return (
        "The token that pages and programs ask for, with all rights (shown only now):",
        f"  {token}",
        f"It is kept in {file}, which only you can read. Add tokens with fewer rights there.",
    )


# Measured cycles of the bus: one second.
CYCLES = 100


def add_report_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "report",
        _report,
        "write one file about this installation and its arm, without secrets, to attach to a report",
        "Collect what helps to find the cause of a problem into one zip file: settings, versions, serial "
        "ports, calibration, the last faults, and the running server's diagnostics and log. When no server runs and "
        "--serial or the settings name a port, the servos are read instead; nothing is written to them. Give the same "
        "options as to armbridge serve. Nothing is sent anywhere.",
    )
    parser.add_argument(
        "--output", type=Path, metavar="FILE.zip", help="the file to write (armbridge-report-TIME.zip, here)"
    )
    add_setting_options(parser)


def _report(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    path: Path = options.output or Path(f"armbridge-report-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip")
    # Imported when it is needed: --help answers without the server's libraries.
    from server.monitoring.report import CONTENTS

    terminal.say("This collects, without tokens, passwords and keys:")
    for name, content in CONTENTS.items():
        terminal.say(f"  {name:14} {content}")
    if path.exists():
        terminal.say(f"armbridge: {path} exists already: name another file (--output)")
        return ExitCode.FAILED
    try:
        packed, sizes = collect(options, terminal)
        # Of the user alone: it names addresses and files.
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(packed)
    except OSError as error:
        terminal.say(f"armbridge: the report cannot be written: {error}")
        return ExitCode.FAILED
    for name, size in sizes.items():
        terminal.say(f"  {name} ({size} bytes)")
    terminal.tell(f"written to {path}")
    terminal.say("It names files, serial ports and addresses of clients: look into it before you publish it.")
    return ExitCode.DONE


def collect(options: argparse.Namespace, terminal: Terminal) -> tuple[bytes, dict[str, int]]:
    from server.access.authentication import Tokens
    from server.monitoring.report import Redactor, Report, RunningServer, add_faults, add_machine, add_settings
    from server.moveit.named_states import data_directory

    problems = []
    try:
        settings, sources = read_settings(options)
    except ConfigurationError as error:
        problems.append(f"settings: {error}; the defaults are reported")
        settings, sources = Settings.model_construct(), {}
    try:
        tokens = dict(Tokens.from_settings(settings.access).secrets())
    except ConfigurationError as error:
        problems.append(f"tokens: {error}")
        tokens = {}
    report = Report(Redactor({*tokens, *_secrets(settings)}, Path.home()))
    for problem in problems:
        report.note(problem)
    with report.part("settings"):
        add_settings(report, settings, sources)
    add_machine(report)
    with report.part("arm"):
        folder = robot_folder.find(settings.arm.robot or DEFAULT_ROBOT)
        report.add_file("arm/robot.toml", folder / "robot.toml")
        file = Description.read(settings.arm).calibration_file
        if file is not None:
            report.add_file("arm/calibration.json", file)
    faults = {settings.diagnostics.directory(data_directory(os.environ))}
    terminal.say("looking for a running server ...")
    runs = False
    with report.part("server"):
        strongest = max(tokens, key=lambda token: tokens[token].role, default=None)
        server = RunningServer(settings, strongest)
        if runs := server.runs:
            faults |= server.add_to(report)
        else:
            report.note(f"server: none answers at {server.address}")
    if not runs:
        with report.part("bus"):
            _add_bus(report, settings, terminal)
    for directory in faults:
        add_faults(report, directory)
    return report.archive(), dict(report.sizes)


def _secrets(settings: Settings) -> Iterator[str]:
    access = settings.access
    named = access.admin_tokens, access.operate_tokens, access.propose_tokens, access.view_tokens
    for token in (access.token, *(token for tokens in named for token in tokens.values())):
        if token is not None:
            yield token.get_secret_value()
    for name, value in os.environ.items():
        if name.upper().startswith(PREFIX) and "TOKEN" in name.upper():
            yield value


def _add_bus(report: Report, settings: Settings, terminal: Terminal) -> None:
    """Read the servos of the port that options or settings name; nothing is written to them."""
    if settings.arm.serial is None:
        report.note("bus: no port is named (--serial PORT), so the servos were not read")
        return
    description = Description.read(settings.arm)
    if description.hardware.kind != "feetech":
        report.note(f"bus: the arm has hardware of the kind {description.hardware.kind}; only Feetech servos are read")
        return
    port = resolve_port(settings.arm.serial)
    terminal.say(f"reading the servos on {port} ...")
    calibration = description.calibration if description.calibration_file is not None else None
    with contextlib.closing(Bus.open(port)) as bus:
        result, findings = examine_bus(bus, description.hardware.servos, calibration, CYCLES, terminal)
        report.add("bus/doctor.json", as_json(findings) + "\n")
        report.add_json("bus/registers.json", {servo: _registers(bus, servo) for servo in sorted(result.ids)})


def _registers(bus: Bus, servo_id: int) -> dict[str, int | None]:
    """Read all registers of a servo by name; None for a register that it does not answer for."""
    values: dict[str, int | None] = {}
    for register in Register:
        values[register.name] = None
        with contextlib.suppress(NoReply):
            values[register.name] = bus.read(servo_id, register)
    return values
