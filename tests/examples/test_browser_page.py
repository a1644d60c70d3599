"""The browser's example in Chromium: joint states come, a button moves the arm, STOP stops it."""

import functools
import http.server
import re
import threading
from collections.abc import Iterator

import pytest

from harness.page import browser_is_missing, chromium
from harness.server import RunningServer
from tests.examples.conftest import EXAMPLES

PATIENCE_MS = 20_000


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Requests are not told."""


@pytest.fixture
def site() -> Iterator[str]:
    """The folder of the examples as a web site."""
    handler = functools.partial(_Quiet, directory=str(EXAMPLES))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as web:
        threading.Thread(target=web.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{web.server_port}"
        web.shutdown()


@pytest.mark.skipif(bool(browser_is_missing()), reason=browser_is_missing())
def test_the_page_shows_the_joints_moves_the_arm_and_stops_it(site: str, server: RunningServer) -> None:
    with chromium() as browser:
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{site}/browser_page.html?port={server.port}")
        page.get_by_text(re.compile(r"gripper: -?\d")).wait_for()
        page.get_by_role("button", name="ready").click()
        page.get_by_text("1 the arm is there").wait_for()
        page.get_by_role("button", name="rest").click()
        page.get_by_role("button", name="STOP").click()
        page.get_by_text(re.compile("^-7 ")).wait_for()
