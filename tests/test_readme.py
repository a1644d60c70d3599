"""README: its program is run as it stands, and its length and links are bounded; settings on their page."""

import re
import sys
from pathlib import Path

from harness.server import CLIENT_ENVIRONMENT, ROOT, RunningServer
from server.config import Settings
from server.config_keys import template
from tests.helpers.programs import run


def blocks(path: Path, language: str) -> list[str]:
    """The fenced code blocks of a page."""
    return re.findall(rf"```{language}\n(.*?)```", path.read_text(), re.DOTALL)


def test_the_python_client_of_the_readme_moves_the_arm(simulated_server: RunningServer) -> None:
    program = blocks(ROOT / "README.md", "python")[0]
    assert "9090" in program, "the program in README.md must connect to port 9090"
    program = program.replace("9090", str(simulated_server.port))
    done = run(sys.executable, "-c", program, env=CLIENT_ENVIRONMENT)
    assert done.stdout == "the arm is there\n", f"correct the program in README.md: {done.stderr}"


def test_the_readme_fits_on_a_screen_and_a_half() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 90
    assert len(text.split()) < 700
    # A sentence on Windows stands on the first screen.
    assert "WSL 2" in "".join(text.splitlines(keepends=True)[:25])


def test_every_page_has_one_place_in_list_and_site() -> None:
    linked = set(re.findall(r"\]\(([\w-]+\.md)", (ROOT / "docs" / "index.md").read_text()))
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages - linked == set(), "link them in docs/index.md"
    placed = re.findall(r"[\w-]+\.md", (ROOT / "mkdocs.yml").read_text().split("\nnav:")[1])
    assert sorted(placed) == sorted(page.name for page in (ROOT / "docs").glob("*.md"))
    assert len(placed) <= 25


def test_the_configuration_page_shows_every_setting() -> None:
    assert blocks(ROOT / "docs" / "configuration.md", "toml")[0] == template(Settings), (
        "put the output of `armbridge config --template` into docs/configuration.md"
    )
