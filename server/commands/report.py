"""Command ``armbridge report``: one file to attach to a report of a problem."""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from robot.description import robot_folder
from robot.errors import NoReply
from robot.hardware.boards import resolve_port
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import Register
from server.arm.setup import DEFAULT_ROBOT, Description
from server.commands.arm import as_json, examine_bus
from server.commands.options import Subparsers, add_command, add_setting_options, read_settings
from server.commands.terminal import ExitCode, Terminal
from server.config import PREFIX, Settings
from server.errors import ConfigurationError

if TYPE_CHECKING:
    from server.monitoring.report import Report


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

    terminal.err("This collects, without tokens, passwords and keys:")
    for name, content in CONTENTS.items():
        terminal.err(f"  {name:14} {content}")
    if path.exists():
        terminal.err(f"armbridge: {path} exists already: name another file (--output)")
        return ExitCode.FAILED
    try:
        packed, sizes = collect(options, terminal)
        # Of the user alone: it names addresses and files.
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(packed)
    except OSError as error:
        terminal.err(f"armbridge: the report cannot be written: {error}")
        return ExitCode.FAILED
    for name, size in sizes.items():
        terminal.err(f"  {name} ({size} bytes)")
    terminal.out(f"written to {path}")
    terminal.err("It names files, serial ports and addresses of clients: look into it before you publish it.")
    return ExitCode.DONE


def collect(options: argparse.Namespace, terminal: Terminal) -> tuple[bytes, dict[str, int]]:
    from server.access.authentication import Tokens
    from server.monitoring.report import Redactor, Report, add_faults, add_machine, add_server, add_settings
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
    terminal.err("looking for a running server ...")
    named: set[Path] | None = set()
    with report.part("server"):
        strongest = max(tokens, key=lambda token: tokens[token].role, default=None)
        named = add_server(report, settings, strongest)
    if named is None:
        with report.part("bus"):
            _add_bus(report, settings, terminal)
    for directory in faults | (named or set()):
        add_faults(report, directory)
    return report.archive(), dict(report.sizes)


def _secrets(settings: Settings) -> Iterator[str]:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.access.authentication import identities

    yield from (token for token, _ in identities(settings.access))
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
    terminal.err(f"reading the servos on {port} ...")
    calibration = description.calibration if description.calibration_file is not None else None
    with contextlib.closing(Bus.open(port)) as bus:
        result, findings = examine_bus(bus, description.hardware.servos, calibration, terminal)
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
