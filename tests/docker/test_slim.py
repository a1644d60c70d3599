"""Taking out of an environment what a running server never loads."""

from pathlib import Path

import pytest

from docker import slim
from tests.helpers.programs import run_python
from tests.helpers.source import PACKAGES, imports, paths


def fill(path: Path, content: str = "x") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    directory = tmp_path / "lib/python3.13/site-packages"
    (directory / "cmeel.prefix/lib").mkdir(parents=True)
    return directory


def slimmed(packages: Path) -> None:
    assert slim.main([str(packages.parents[2])]) == 0


GOES = [
    "cmeel.prefix/include/pinocchio/multibody/data.hxx",
    "cmeel.prefix/lib/cmake/coal/coalConfig.cmake",
    "cmeel.prefix/lib/libboost.a",
    "cmeel.prefix/bin/pinocchio_bench",
    "scipy/linalg/tests/test_basic.py",
    "uvloop/loop.pyx",
    "scipy/optimize/__init__.py",
    "zstandard/_cffi.cpython-313-x86_64-linux-gnu.so",
]

STAYS = [
    "cmeel.prefix/lib/libcoal.so",
    "cmeel.prefix/lib/python3.13/site-packages/coal/__init__.py",
    "cmeel.prefix/share/doc/coal/LICENSE",
    "numpy/testing/__init__.py",
    "scipy/spatial/__init__.py",
    "zstandard/backend_c.cpython-313-x86_64-linux-gnu.so",
]


def test_what_the_server_never_loads_goes_and_the_rest_stays(packages: Path) -> None:
    for name in (*GOES, *STAYS):
        fill(packages / name)
    slimmed(packages)
    assert [name for name in GOES if (packages / name).exists()] == []
    assert [name for name in STAYS if (packages / name).read_text() != "x"] == []


def test_a_library_under_three_names_is_kept_once(tmp_path: Path) -> None:
    names = ("libcoal.so", "libcoal.so.3", "libcoal.so.3.0.2")
    for name in names:
        fill(tmp_path / name, "code")
    other = fill(tmp_path / "libother.so", "else")
    assert slim.link_copies(tmp_path) == 2 * len("code")
    assert not other.is_symlink()
    assert [(tmp_path / name).read_text() for name in names] == ["code"] * 3
    assert slim.size_bytes(tmp_path / "libcoal.so") == len("code")
    assert all((tmp_path / name).is_symlink() for name in names[1:])


def test_it_tells_how_much_each_step_has_saved(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(packages / "scipy/tests/big", "x" * 2_000_000)
    slimmed(packages)
    lines = capsys.readouterr().out.splitlines()
    assert "    2.0 MB  tests of packages" in lines
    assert lines[-1] == "    2.0 MB  in all"


def test_of_scipy_nothing_goes_that_the_planners_load_or_ours_import() -> None:
    program = "import sys, scipy.spatial, scipy.sparse.csgraph; print(*sys.modules)"
    done = run_python(program)
    loaded = {name.split(".")[1] for name in done.stdout.split() if name.startswith("scipy.")}
    assert {"spatial", "sparse"} <= loaded
    assert loaded & set(slim.SCIPY) == set()
    of_ours = [imports(path) for package in PACKAGES for path in paths(package)]
    names = {name for each in of_ours for name in each.names | each.sources if name.startswith("scipy.")}
    assert {name.split(".")[1] for name in names} == {"spatial", "sparse"}
