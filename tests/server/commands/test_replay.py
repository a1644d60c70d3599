from __future__ import annotations

from pathlib import Path

import pytest

from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.recorded import record, text


def test_a_recording_is_played_to_its_end(tmp_path: Path) -> None:
    path = record(tmp_path / "run.mcap", [text(0), text(1)])
    assert cli.main(["replay", str(path), "--port", "0", "--rate", "100"]) == ExitCode.DONE


def test_a_file_that_is_no_recording_is_one_line_and_exit_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("no recording")
    assert cli.main(["replay", str(tmp_path / "notes.txt"), "--port", "0"]) == ExitCode.FAILED
    assert capsys.readouterr().err == f"armbridge: recording {tmp_path / 'notes.txt'}: is not an MCAP file\n"


def test_an_address_that_others_reach_needs_a_token_here_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = record(tmp_path / "run.mcap", [text(0), text(1)])
    arguments = ["replay", str(path), "--host", "0.0.0.0", "--port", "0", "--rate", "100"]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "ARMBRIDGE_ACCESS__TOKEN" in capsys.readouterr().err
    assert cli.main([*arguments, "--insecure"]) == ExitCode.DONE
    monkeypatch.setenv("ARMBRIDGE_ACCESS__TOKEN", "correct-horse-battery")
    assert cli.main(arguments) == ExitCode.DONE


def test_the_settings_of_a_file_hold_here_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path / "run.mcap", [text(0), text(1)])
    (tmp_path / "armbridge.toml").write_text("[server]\nport = 70000\n")
    assert cli.main(["replay", str(path), "--config", str(tmp_path / "armbridge.toml")]) == ExitCode.USAGE
    assert "server.port" in capsys.readouterr().err


WRONG = {
    "rate": (["--rate", "0"], "argument --rate: must be 0.01 to 100, not '0'"),
    "no number": (["--rate", "fast"], "argument --rate: must be 0.01 to 100, not 'fast'"),
    "port": (["--port", "70000"], "argument --port: must be 0 to 65535, not '70000'"),
    "delay": (["--delay", "-1"], "argument --delay: must be 0 to 3600, not '-1'"),
}


@pytest.mark.parametrize(("arguments", "words"), WRONG.values(), ids=WRONG.keys())
def test_an_option_out_of_range_is_named_with_its_limits(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", "run.mcap", *arguments])
    assert ended.value.code == ExitCode.USAGE
    assert words in capsys.readouterr().err
