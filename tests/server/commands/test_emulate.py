from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
from pathlib import Path

import pytest

from robot.hardware.feetech.bus import Bus
from server.commands import emulate
from server.commands.terminal import ExitCode


def parse(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    emulate.add_parser(parser.add_subparsers())
    return parser.parse_args(["emulate", *arguments])


def test_a_start_that_cannot_be_is_told_in_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    options = parse("--start=0,0")
    assert options.run(options) == ExitCode.FAILED
    assert "armbridge: the start pose needs 6 positions, not 2" in capsys.readouterr().err


def test_help_lists_options_and_live_commands(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse("--help")
    printed = capsys.readouterr().out
    assert "--lose-instruction" in printed
    assert '{"plugged": "renamed"}' in printed


def test_it_prints_the_port_of_six_servos_and_runs_until_told_to_end(tmp_path: Path) -> None:
    program = f"""
import argparse
from server.commands import emulate
parser = argparse.ArgumentParser()
emulate.add_parser(parser.add_subparsers())
options = parser.parse_args(["emulate", "--link", {str(tmp_path / "arm")!r}])
raise SystemExit(options.run(options))
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().strip() == str((tmp_path / "arm").readlink())
            with contextlib.closing(Bus.open(str(tmp_path / "arm"))) as bus:
                assert [bus.ping(servo_id) for servo_id in range(1, 7)] == [777] * 6
            process.terminate()
            assert process.wait(5.0) == 0
        finally:
            process.kill()
