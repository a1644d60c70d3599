from __future__ import annotations

import pytest

from robot.emulator.__main__ import main


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--start=0,0,0"], "needs 6 positions, not 3"),
        (["--start=0,9,0,0,0,0"], "shoulder_lift cannot start at 9 rad"),
        (["--calibration", "/nowhere.json"], "/nowhere.json: cannot be read"),
        (["--write-log", "/nowhere/log"], "/nowhere/log"),
    ],
)
def test_what_cannot_be_emulated_is_refused_in_a_sentence(capsys, arguments, sentence):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err


def test_help_names_options_and_live_commands(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    for option in ("drop", "corrupt", "seed", "start", "calibration", "write-log", "link", "control-fd"):
        assert f"--{option}" in printed
    assert '{"obstacle": {"3": 2100}}' in printed
