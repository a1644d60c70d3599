from __future__ import annotations

import pytest

from robot.description import robot_folder
from server import cli
from server.commands.terminal import ExitCode
from tests.helpers.stl_arm import write_package


@pytest.fixture
def urdf(tmp_path):
    return write_package(tmp_path)


def test_an_import_says_what_it_made_and_how_to_serve_it(urdf, tmp_path, capsys):
    out = tmp_path / "arm"
    assert (
        cli.main(["robot", "import", str(urdf), "--out", str(out), "--samples", "50", "--no-convex"]) == ExitCode.DONE
    )
    printed = capsys.readouterr()
    assert f"next: armbridge serve --robot {out}" in printed.out
    assert "50 of 50 states" in printed.err
    assert robot_folder.load(out).model.default_group == "arm"


def test_an_import_that_cannot_be_done_says_so_in_one_sentence(tmp_path, capsys):
    assert cli.main(["robot", "import", str(tmp_path / "no.urdf")]) == ExitCode.FAILED
    assert capsys.readouterr().err.startswith(f"armbridge: {tmp_path / 'no.urdf'} cannot be read: ")


def test_packages_may_be_elsewhere(urdf, tmp_path, capsys):
    elsewhere = tmp_path / "elsewhere" / "arm.urdf"
    elsewhere.parent.mkdir()
    urdf.rename(elsewhere)
    (tmp_path / "mesh_arm").rename(tmp_path / "elsewhere" / "deep")
    (tmp_path / "packages").mkdir()
    (tmp_path / "elsewhere" / "deep").rename(tmp_path / "packages" / "mesh_arm")
    arguments = ["robot", "import", str(elsewhere), "--out", str(tmp_path / "arm"), "--samples", "10", "--no-convex"]
    assert cli.main(arguments) == ExitCode.USAGE
    assert "--package-path" in capsys.readouterr().err
    assert cli.main([*arguments, "--package-path", str(tmp_path / "packages")]) == ExitCode.DONE
