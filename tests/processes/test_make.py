"""``make run`` on a machine that lacks something: a sentence, and nothing half made."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from harness.server import ROOT
from tests.helpers.programs import run

# Stands in for python3: answers what make asks, notes what it is called with, and does as the variables say.
PYTHON = """#!/bin/sh
echo "python3 $*" >>"$CALLS"
case "$*" in
*ensurepip*) exit "${NO_ENSUREPIP:-0}" ;;
"-m venv"*)
    for folder; do :; done
    mkdir -p "$folder/bin" && cp "$0" "$folder/bin/python"
    [ -z "$VENV_FAILS" ] || exit 1
    touch "$folder/bin/pip" && printf '#!/bin/sh\\necho serving\\n' >"$folder/bin/armbridge"
    chmod +x "$folder/bin/armbridge" ;;
esac
"""

NPM = """#!/bin/sh
echo "npm $*" >>"$CALLS"
[ -z "$NPM_FAILS" ] || { echo "40 lines of npm" >&2; exit 1; }
mkdir -p node_modules dist && touch node_modules/.package-lock.json dist/index.html
"""


class Checkout:
    """What make needs of a checkout, and a machine whose programs are made up."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "checkout"
        self.programs = folder / "programs"
        self.calls = folder / "calls"
        page = self.folder / "server" / "page"
        for made in (self.programs, page / "src", page / "public"):
            made.mkdir(parents=True)
        for name in ("Makefile", "pyproject.toml", "requirements.lock"):
            shutil.copy(ROOT / name, self.folder)
        for name in ("index.html", "package.json", "package-lock.json", "node_version.mjs"):
            shutil.copy(ROOT / "server" / "page" / name, page)
        (self.folder / "clients" / "python").mkdir(parents=True)
        shutil.copy(ROOT / "clients" / "python" / "pyproject.toml", self.folder / "clients" / "python")
        shutil.copytree(ROOT / "protocol" / "interfaces", self.folder / "protocol" / "interfaces")
        self.program("python3", PYTHON)
        for name in ("sh", "make", "mkdir", "cp", "touch", "chmod", "rm", "find", "env"):
            found = shutil.which(name)
            assert found is not None
            (self.programs / name).symlink_to(found)

    def program(self, name: str, text: str) -> None:
        """Put a program on the machine."""
        file = self.programs / name
        file.write_text(text)
        file.chmod(0o755)

    def node(self, version: str) -> None:
        """Put a Node.js on the machine that says it is of a version."""
        real = shutil.which("node")
        if real is None:
            pytest.skip("needs Node.js, to run the check of its version")
        preload = self.folder.parent / "version.cjs"
        preload.write_text(f"Object.defineProperty(process.versions, 'node', {{ value: '{version}' }})")
        self.program("npm", NPM)
        self.program("node", f'#!/bin/sh\nexec "{real}" --require "{preload}" "$@"\n')

    def run(self, **environment: str) -> subprocess.CompletedProcess[str]:
        """Call ``make run``."""
        self.calls.write_text("")
        environment = {"PATH": str(self.programs), "CALLS": str(self.calls), "HOME": os.environ["HOME"], **environment}
        return run("make", "--no-print-directory", "run", cwd=self.folder, env=environment)


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def serves(done: subprocess.CompletedProcess[str]) -> bool:
    return (done.returncode, done.stdout.splitlines()[-1]) == (0, "serving")


def test_without_venv_it_names_the_package_and_makes_no_environment(checkout: Checkout) -> None:
    done = checkout.run(NO_ENSUREPIP="1")
    assert done.returncode != 0
    assert "apt-get install python3-venv" in done.stderr
    assert not (checkout.folder / ".venv").exists()
    assert serves(checkout.run())


def test_an_environment_that_fails_half_way_is_removed_and_one_of_before_is_made_again(checkout: Checkout) -> None:
    assert checkout.run(VENV_FAILS="1").returncode != 0
    assert not (checkout.folder / ".venv").exists()
    (checkout.folder / ".venv" / "bin").mkdir(parents=True)
    shutil.copy(checkout.programs / "python3", checkout.folder / ".venv" / "bin" / "python")
    assert serves(checkout.run())
    assert "-m venv --clear .venv" in checkout.calls.read_text()


@pytest.mark.parametrize("version", ["20.18.3", "21.7.0", "22.11.0"])
def test_a_node_that_is_too_old_is_named_in_one_line(checkout: Checkout, version: str) -> None:
    checkout.node(version)
    done = checkout.run()
    assert serves(done)
    assert done.stderr == f"Node.js {version} cannot build the page, which needs Node.js ^20.19.0 || >=22.12.0\n"
    assert "npm" not in checkout.calls.read_text()


@pytest.mark.parametrize("version", ["20.19.0", "22.12.0", "24.0.0"])
def test_with_a_node_that_will_do_the_page_is_built(checkout: Checkout, version: str) -> None:
    checkout.node(version)
    checkout.run()
    assert "npm run build" in checkout.calls.read_text()


def test_a_page_that_cannot_be_built_is_tried_again_only_after_a_change(checkout: Checkout) -> None:
    checkout.node("22.12.0")
    first = checkout.run(NPM_FAILS="1")
    assert "40 lines of npm" in first.stderr
    assert "make page tries again" in first.stderr
    second = checkout.run(NPM_FAILS="1")
    assert (serves(second), second.stderr) == (True, "")
    (checkout.folder / "server" / "page" / "src" / "main.ts").touch()
    # Newer than what was tried, whatever the file system's clock shows.
    os.utime(checkout.folder / "build" / "page.tried", (0, 0))
    assert checkout.run(NPM_FAILS="1").returncode == 0
    assert "npm" in checkout.calls.read_text()
