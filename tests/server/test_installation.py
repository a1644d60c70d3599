"""What the installed program says about itself."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path

import pytest

from harness.server import ROOT
from server import cli
from server.installation import PAGE_DIRECTORY, version_line


def test_the_version_names_the_program_and_the_page(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text('<head>\n<meta name="version" content="0.1.9">\n</head>')
    assert version_line(tmp_path) == f"armbridge {metadata.version('armbridge')}, page 0.1.9"


def test_without_a_page_the_version_says_so(tmp_path: Path) -> None:
    assert version_line(tmp_path).endswith(", without the page")


def test_a_page_from_before_pages_had_versions_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("<head></head>")
    assert version_line(tmp_path).endswith(", page of an unknown version")


def test_the_command_prints_this_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--version"])
    assert " ".join(capsys.readouterr().out.split()) == version_line(PAGE_DIRECTORY)


def test_the_version_of_the_project_heads_the_changelog() -> None:
    (version,) = re.findall(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version
