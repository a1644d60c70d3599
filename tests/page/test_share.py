"""What is shown to others: a page that may only look, a page on a phone that drives, and a film of the last seconds."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser
from websockets.sync import client as blocking

from harness.clients import call_on, goal
from harness.page import PHONE, SHARED, OpenPage, opened
from harness.server import RunningServer

TOKEN = "a-token-of-an-administrator-for-this-test"

# Every WebM begins with the EBML header (RFC 8794, section 11.2.1).
EBML = bytes.fromhex("1a45dfa3")


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    """A server on the network, which asks for a token."""
    with RunningServer("--port 0 --host 0.0.0.0", {**SHARED, "ARMBRIDGE_ACCESS__TOKEN": TOKEN}) as running:
        yield running


def test_the_last_seconds_are_saved_as_a_film(browser: Browser, server: RunningServer, tmp_path: Path) -> None:
    with opened(browser, draws=True) as page:
        page.open(server.port, f"#token={TOKEN}")
        assert_film_is_saved(page, server, tmp_path)


def assert_film_is_saved(page: OpenPage, server: RunningServer, tmp_path: Path) -> None:
    page.open_panel("settings")
    assert page.part("film-save").is_disabled()
    page.part("film-on").check()
    for pose in ("home", "ready"):
        assert goal(f"{server.url}&token={TOKEN}", "/moveit_goal_named", {"data": pose})["val"] == 1
    film = page.download("film-save", tmp_path).read_bytes()
    assert film.startswith(EBML)
    assert len(film) > 2000
    # The next one is filmed already.
    page.until("!document.querySelector('[data-testid=film-save]').disabled")
    page.part("film-on").uncheck()
    assert page.part("film-save").is_disabled()


def test_a_code_lets_a_page_in_that_only_looks(browser: Browser, server: RunningServer) -> None:
    with opened(browser) as page:
        page.open(server.port, f"#token={TOKEN}")
        page.open_panel("settings")
        page.part("share-show-code").click()
        page.part("share-qr").wait_for()
        token = (page.part("share-address").text_content() or "").partition("#token=")[2]
        with opened(browser, PHONE, has_touch=True, is_mobile=True) as other:
            other.open(server.port, f"#token={token}")
            other.until_state("s.identity?.role === 'view'")
            other.until_text("control", "Read only")
            other.open_panel("move")
            assert other.part("relax").is_disabled()


def test_the_code_lets_one_phone_in(browser: Browser, server: RunningServer) -> None:
    with opened(browser) as page:
        page.open(server.port, f"#token={TOKEN}")
        page.open_panel("drive")
        page.page.locator("#section-phone > summary").click()
        page.part("phone-show-code").click()
        page.until_text("phone-note", "lets one phone in")
        page.until_text("phone-note", "not encrypted")
        address = page.part("phone-address").text_content() or ""
        assert finder_pattern(page) == [True, False, True, True, True, False, True]
        token = address.partition("#token=")[2]
        assert token not in ("", TOKEN)
        with opened(browser, PHONE, has_touch=True, is_mobile=True) as phone:
            phone.open(server.port, f"#token={token}")
            phone.until_state("s.identity?.role === 'operate'")
            with blocking.connect(f"ws://127.0.0.1:{server.port}") as other:
                other.send(f'{{"op": "auth", "token": "{token}"}}')
                with pytest.raises(Exception, match="one-time token lets one connection in"):
                    call_on(other, "/arm/who_am_i")
        assert not any(token in line for line in server.lines)


def finder_pattern(page: OpenPage) -> list[bool]:
    """The fourth row of the pattern in the corner of every QR code, dark modules being true."""
    path = "document.querySelector('[data-testid=phone-qr] path')"
    inside = f"{path}.isPointInFill(new DOMPoint(column + 0.5, 3.5))"
    dark: list[bool] = page.page.evaluate(f"Array.from({{ length: 7 }}, (_, column) => {inside})")
    return dark
