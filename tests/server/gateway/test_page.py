from __future__ import annotations

from pathlib import Path

import pytest

from server.errors import FileTooLargeError, ServiceError
from server.gateway import page
from server.gateway.page import find_page_file, is_built


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    (tmp_path / "secret").write_text("key")
    made = tmp_path / "dist"
    made.mkdir()
    (made / "index.html").write_text("page")
    (made / "out").symlink_to(tmp_path / "secret")
    return made


def test_the_page_itself_has_no_name(directory: Path) -> None:
    assert is_built(directory)
    assert find_page_file(directory, "") == find_page_file(directory, "index.html") == directory / "index.html"


@pytest.mark.parametrize("name", ["../secret", "out", ".", "no", "\0", "a" * 999])
def test_nothing_outside_is_a_file_of_the_page(directory: Path, name: str) -> None:
    with pytest.raises(ServiceError, match="is no file of the page"):
        find_page_file(directory, name)


def test_what_is_too_large_to_be_one_is_refused_with_the_limit(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "MAX_FILE_BYTES", 3)
    with pytest.raises(FileTooLargeError, match="4 bytes, the limit is 3"):
        find_page_file(directory, "")


def test_where_nothing_was_built_there_is_no_page(tmp_path: Path) -> None:
    assert not is_built(tmp_path)


def test_whoever_finds_no_page_is_told_how_to_get_it() -> None:
    assert "npm" in page.HOW_TO_GET_IT
    assert page.HOW_TO_GET_IT in page.NOT_BUILT
