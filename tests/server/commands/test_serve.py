from __future__ import annotations

import re
from pathlib import Path

import pytest

from server import cli
from server.app import App
from server.commands.terminal import ExitCode
from tests.helpers.seven_joint_arm import SRDF, URDF


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


SECOND_LIMIT = '<limit lower="-1.9" upper="1.9" velocity="2" effort="9"/>'

NO_ARM = {
    "no joint that moves": (
        re.sub(r"<axis[^>]*><limit[^>]*>", "", URDF).replace('"revolute"', '"fixed"'),
        "URDF has no movable joint: no <joint> has the type revolute, continuous or prismatic",
    ),
    "no limit": (URDF.replace(SECOND_LIMIT, ""), "URDF joint 'a2' has no <limit>"),
    "no range": (URDF.replace('lower="-1.9" ', ""), "URDF joint 'a2' <limit> has no attribute 'lower'"),
    "no speed": (
        URDF.replace('velocity="2.5"', 'velocity="0"'),
        "URDF joint 'a4' <limit> velocity must be above 0, not 0",
    ),
}


@pytest.fixture
def never_served(monkeypatch):
    """Fails at a server that would be run."""

    async def run(_app):
        raise AssertionError("it is served")

    monkeypatch.setattr(App, "run", run)


def described(folder: Path, urdf: str) -> list[str]:
    """The options that name a robot's description, which is written to files."""
    files = {"--urdf": (folder / "arm.urdf", urdf), "--srdf": (folder / "arm.srdf", SRDF)}
    for path, text in files.values():
        path.write_text(text)
    return [word for option, (path, _) in files.items() for word in (option, str(path))]


@pytest.mark.usefixtures("never_served")
@pytest.mark.parametrize(("urdf", "sentence"), NO_ARM.values(), ids=NO_ARM.keys())
def test_a_description_of_no_arm_is_one_line_that_names_joint_and_element_and_exit_2(urdf, sentence, tmp_path, capsys):
    assert cli.main(["serve", *described(tmp_path, urdf)]) == ExitCode.USAGE
    assert capsys.readouterr().err == f"armbridge: {sentence}\n"


@pytest.mark.usefixtures("never_served")
def test_a_fault_of_a_bus_is_refused_for_an_ideal_arm_which_has_none(tmp_path, capsys):
    options = ["--set", "emulator.drop=0.1", *described(tmp_path, URDF)]
    assert cli.main(["serve", *options]) == ExitCode.USAGE
    assert capsys.readouterr().err == (
        "armbridge: emulator.drop: the ideal arm (arm.urdf without arm.serial or arm.calibration) has no servo bus "
        "that 0.1 could apply to\n"
    )
