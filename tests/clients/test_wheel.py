"""The wheel as its users get it: with the page as it was built, without its sources, and without Node."""

import json
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.helpers.programs import UV, run

ROOT = Path(__file__).parents[2]

PARTS = (
    "armbridge.py",
    "docs",
    "hatch_build.py",
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
                ROOT / part,
                made / part,
                ignore=shutil.ignore_patterns("node_modules", "dist", "docs_site", "__pycache__"),
            )
        else:
            shutil.copy(ROOT / part, made / part)
    # Where git's folder is, hatch looks for what git ignores.
    (made / ".git").mkdir()
    (made / "server" / "docs_site").mkdir()
    (made / "server" / "docs_site" / "index.html").write_text("built")
    for name in ("dist/index.html", "dist/licenses.md", "dist/assets/vendor.js", "node_modules/three/three.js"):
        file = made / "server" / "page" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("built")
    return made


@pytest.fixture(scope="module")
def wheel(checkout: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    # By way of the sdist, which therefore has all that is needed.
    build(checkout, out).check_returncode()
    (made,) = out.glob("*.whl")
    return made


def build(checkout: Path, out: Path) -> subprocess.CompletedProcess[str]:
    return run(UV, "build", "--out-dir", out, checkout)


def names_in(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_of_the_page_it_has_what_was_built_and_nothing_else(wheel: Path) -> None:
    names = {name for name in names_in(wheel) if name.startswith("server/page/")}
    assert names == {f"server/page/dist/{name}" for name in ("index.html", "licenses.md", "assets/vendor.js")}


def test_it_has_the_types_the_arms_the_docs_and_the_licences(wheel: Path) -> None:
    names = names_in(wheel)
    data = next(name for name in names if ".data/" in name).split("/")[0]
    info = data.replace(".data", ".dist-info")
    for folder in ("server", "protocol", "robot", "planners"):
        assert f"{folder}/py.typed" in names
    for folder in ("protocol/interfaces", *(f"robot/arms/{arm.name}" for arm in (ROOT / "robot/arms").glob("[!_]*/"))):
        files = {f"{folder}/{file.name}" for file in (ROOT / folder).iterdir() if file.is_file()}
        assert files <= names
    pages = {f"{data}/data/share/doc/armbridge/docs/{page.name}" for page in (ROOT / "docs").glob("*.md")}
    assert {*pages, "server/docs_site/index.html"} <= names
    assert {f"{info}/licenses/LICENSE", f"{info}/licenses/robot/arms/so101/NOTICE", "armbridge.py"} <= names


def test_it_has_no_tests_and_nothing_else_at_the_top_level(wheel: Path) -> None:
    tops = {name.split("/")[0] for name in names_in(wheel)}
    ours = {"armbridge.py", "server", "protocol", "robot", "planners"}
    assert {name for name in tops if not name.endswith((".dist-info", ".data"))} == ours


def test_the_sdist_has_no_tests(wheel: Path) -> None:
    (sdist,) = wheel.parent.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = archive.getnames()
    assert [name for name in names if name.split("/")[1:2] == ["tests"]] == []


def test_its_description_links_to_no_file_that_an_index_does_not_have(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        metadata = archive.read(name).decode()
    targets = re.findall(r"\]\(([^)]+)\)", metadata)
    assert targets
    assert [target for target in targets if not target.startswith(("http:", "https:", "#"))] == []


def test_its_licence_names_those_of_the_libraries_in_the_page() -> None:
    lock = json.loads((ROOT / "server/page/package-lock.json").read_text())
    bundled = {each["license"] for name, each in lock["packages"].items() if name and not each.get("dev")}
    (named,) = re.findall(r'^license = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert bundled <= set(named.split(" AND "))


@pytest.mark.parametrize(
    "parts",
    [
        (
            "server/page/dist/index.html",
            "server/docs_site/index.html",
            "docs/configuration.md",
            "protocol/interfaces/ros2.json",
        ),
        # Hatch itself misses a licence before our hook is asked.
        ("robot/arms/so101/NOTICE",),
    ],
)
def test_without_its_parts_it_is_not_built(checkout: Path, tmp_path: Path, parts: tuple[str, ...]) -> None:
    away = {part: (checkout / part).rename(tmp_path / part.replace("/", "-")) for part in parts}
    try:
        done = build(checkout, tmp_path / "out")
    finally:
        for part, kept in away.items():
            kept.rename(checkout / part)
    assert done.returncode != 0
    for part in parts:
        assert f"{part} (" in done.stderr or (part.endswith("NOTICE") and "NOTICE" in done.stderr)


def test_once_installed_the_server_finds_its_page(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "installed"
    run(UV, "pip", "install", "--quiet", "--no-deps", "--target", target, wheel, check=True)
    program = (
        f"import sys; sys.path.insert(0, {str(target)!r})\n"
        "from server.gateway import http\n"
        "print(http.find_page_file(http.PAGE_DIRECTORY, 'assets/vendor.js').read_text())\n"
    )
    found = run(sys.executable, "-P", "-c", program, cwd=tmp_path)
    assert found.stdout == "built\n"
