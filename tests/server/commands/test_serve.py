from __future__ import annotations

import pytest

from server import cli
from server.commands.terminal import ExitCode


def test_an_id_that_lerobot_does_not_know_is_one_line_and_exit_2(capsys):
    assert cli.main(["serve", "--calibration", "nobodys"]) == ExitCode.USAGE
    assert capsys.readouterr().err.count("\n") == 1


USAGE = {
    "wrong setting": (["--port", "70000"], "server.port"),
    "urdf alone": (["--urdf", "a.urdf"], "urdf and srdf must be given together"),
    "missing configuration": (["--config", "/nowhere.toml"], "/nowhere.toml cannot be read"),
}


@pytest.mark.parametrize(("arguments", "words"), USAGE.values(), ids=USAGE.keys())
def test_a_wrong_setting_is_one_line_and_exit_2(arguments, words, capsys):
    assert cli.main(["serve", *arguments]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error
