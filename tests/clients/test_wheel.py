"""The wheel as its users get it: with the page as it was built, without its sources, and without Node."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

PARTS = (
    "server",
    "protocol",
    "robot",
    "planners",
    "pyproject.toml",
    "README.md",
    "LICENSE",
    "CHANGELOG.md",
    ".gitignore",
)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources with a page that was built, and what building it leaves behind."""
    made = tmp_path_factory.mktemp("checkout")
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(
                ROOT / part, made / part, ignore=shutil.ignore_patterns("node_modules", "dist", "__pycache__")
            )
        else:
            shutil.copy(ROOT / part, made / part)
    # Where git's folder is, hatch looks for what git ignores.
    (made / ".git").mkdir()
    for name in ("dist/index.html", "dist/assets/vendor.js", "node_modules/three/three.js"):
        file = made / "server" / "page" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("built")
    return made


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    uv = Path(sys.executable).with_name("uv")
    # By way of the sdist, which therefore has all that is needed.
    subprocess.run([uv, "build", "--quiet", "--out-dir", out, checkout], check=True, timeout=120)
    (made,) = out.glob("*.whl")
    return made


def test_of_the_page_it_has_what_was_built_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if name.startswith("server/page/")}
    assert names == {"server/page/dist/index.html", "server/page/dist/assets/vendor.js"}


def test_once_installed_the_server_finds_its_page(wheel: Path, tmp_path: Path) -> None:
    uv = Path(sys.executable).with_name("uv")
    target = tmp_path / "installed"
    subprocess.run([uv, "pip", "install", "--quiet", "--no-deps", "--target", target, wheel], check=True, timeout=120)
    program = (
        f"import sys; sys.path.insert(0, {str(target)!r})\n"
        "from server.gateway import http\n"
        "print(http.find_page_file(http.PAGE_DIRECTORY, 'assets/vendor.js').read_text())\n"
    )
    found = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout == "built\n"
