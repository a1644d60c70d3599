"""The command ``armbridge``."""

import argparse
import logging
import os
import re
import select
import sys
import threading
import time
from collections.abc import Sequence
from typing import NoReturn

from server.commands import arm, calibrate, certificate, config, export, plan, publish, report, robot, serve, setup
from server.commands.options import guarded
from server.commands.terminal import EXIT_CODES, ExitCode
from server.config_keys import unknown
from server.installation import version_line

# In the order in which someone with a new arm needs them.
COMMANDS = (
    serve.add_serve_parser,
    setup.add_setup_parser,
    arm.add_scan_parser,
    calibrate.add_calibrate_parser,
    arm.add_verify_parser,
    arm.add_doctor_parser,
    arm.add_relax_parser,
    robot.add_robot_parser,
    plan.add_plan_parser,
    serve.add_classroom_parser,
    publish.add_leader_parser,
    serve.add_replay_parser,
    publish.add_camera_parser,
    export.add_export_parser,
    serve.add_emulate_parser,
    certificate.add_certificate_parser,
    config.add_config_parser,
    config.add_systemd_unit_parser,
    report.add_report_parser,
)

# Time for threads to end what they do at the end of the process, such as writing a file [s].
THREADS_END_S = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    try:
        parser = _parser()
    except KeyboardInterrupt:
        sys.exit("armbridge: stopped")
    options, others = parser.parse_known_args(arguments)
    if others:
        known = re.findall(r"--[\w-]+", options.usage)
        # What stands behind an option that does not exist is not known either.
        wrong = [each.partition("=")[0] for each in others if each.startswith("-")] or others
        parser.error("; ".join(unknown(each, known) for each in wrong))
    return guarded(lambda terminal: options.run(options, terminal))


def run_process() -> NoReturn:
    """Run the command and end the process with its exit code.

    A daemon thread is in the middle of a library's call when that did not end in time, as zenoh's with a machine that
    reads nothing. When such a thread comes back to an interpreter that is being finalized, Python ends it, for which a
    library in Rust aborts the process (exit code 134). So the interpreter is not finalized then. Nor is it where a
    thread waits for a disk that does not answer: Python would wait for the thread without an end.
    """
    try:
        try:
            code = main()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        if not _reader_has_left():
            raise
        # It has read enough, as `head` does. Python flushes at its end, where it could only complain:
        # https://docs.python.org/3/library/signal.html#note-on-sigpipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = ExitCode.FAILED
    until_s = time.monotonic() + THREADS_END_S
    for thread in threading.enumerate():
        if not thread.daemon and thread is not threading.current_thread():
            thread.join(max(until_s - time.monotonic(), 0.0))
    if threading.active_count() > 1:
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _reader_has_left() -> bool:
    poll = select.poll()
    # An error is reported without being asked for.
    poll.register(sys.stdout.fileno(), 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="armbridge",
        description="Drive a robot arm from any rosbridge client, without ROS. A new SO-101: setup, scan, "
        "calibrate, doctor, then serve.",
        epilog=f"{EXIT_CODES} armbridge COMMAND --help explains a command.",
    )
    parser.add_argument("--version", action="version", version=version_line())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for add_command in COMMANDS:
        add_command(commands)
    for described in commands.choices.values():
        described.set_defaults(usage=described.format_usage())
    return parser


if __name__ == "__main__":
    run_process()
