"""What is shown to others: a page that may only look, and a film of the last seconds."""

from pathlib import Path

from playwright.sync_api import Browser

from harness.clients import goal
from harness.page import PHONE, SHARED, OpenPage, opened
from harness.server import RunningServer

SETTINGS = SHARED

TOKEN = "a-token-of-an-administrator-for-this-test"

# Every WebM begins with the EBML header (RFC 8794, section 11.2.1).
EBML = bytes.fromhex("1a45dfa3")


def test_the_last_seconds_are_saved_as_a_film(browser: Browser, server: RunningServer, tmp_path: Path) -> None:
    with opened(browser, draws=True) as page:
        page.open(server.port)
        assert_film_is_saved(page, server, tmp_path)


def assert_film_is_saved(page: OpenPage, server: RunningServer, tmp_path: Path) -> None:
    page.open_panel("settings")
    assert page.part("film-save").is_disabled()
    page.part("film-on").check()
    for pose in ("home", "ready"):
        assert goal(server.url, "/moveit_goal_named", {"data": pose})["val"] == 1
    film = page.download("film-save", tmp_path).read_bytes()
    assert film.startswith(EBML)
    assert len(film) > 2000
    # The next one is filmed already.
    page.until("!document.querySelector('[data-testid=film-save]').disabled")
    page.part("film-on").uncheck()
    assert page.part("film-save").is_disabled()


def test_a_code_lets_a_page_in_that_only_looks(browser: Browser) -> None:
    settings = {"ARMBRIDGE_ACCESS__TOKEN": TOKEN}
    with RunningServer("--port 0 --host 0.0.0.0", settings) as server, opened(browser) as page:
        page.open(server.port, f"#token={TOKEN}")
        page.open_panel("settings")
        page.part("share-show-code").click()
        page.part("share-qr").wait_for()
        token = (page.part("share-address").text_content() or "").partition("#token=")[2]
        with opened(browser, PHONE, locale="en") as other:
            other.open(server.port, f"#token={token}")
            other.until_state("s.identity?.role === 'view'")
            other.until_text("control", "Read only")
            other.open_panel("move")
            assert other.part("relax").is_disabled()
