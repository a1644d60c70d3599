"""The browser's example in Chromium: joint states come, a button moves the arm, STOP stops it."""

from __future__ import annotations

import functools
import http.server
import os
import re
import shlex
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.examples.conftest import EXAMPLES
from tests.helpers.server import RunningServer

PATIENCE_MS = 20_000


@pytest.fixture
def chromium(tmp_path: Path) -> str:
    """Chromium on time that nobody else wants: run by root it raises its priority, and the arm's servos fall silent."""
    found = shutil.which("chromium")
    if found is None:
        pytest.skip("chromium is not installed")
    words = ["chrt", "--idle", "0", found] if shutil.which("chrt") else [found]
    if os.geteuid() == 0 and shutil.which("setpriv"):
        words = ["setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice", *words]
    modest = tmp_path / "chromium"
    modest.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    modest.chmod(0o755)
    return str(modest)


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


def test_the_page_shows_the_joints_moves_the_arm_and_stops_it(site: str, chromium: str, server: RunningServer) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{site}/browser_page.html?port={server.port}")
        page.get_by_text(re.compile(r"gripper: -?\d")).wait_for()
        page.get_by_role("button", name="ready").click()
        page.get_by_text("1 the arm is there").wait_for()
        page.get_by_role("button", name="rest").click()
        page.get_by_role("button", name="STOP").click()
        page.get_by_text(re.compile("^-7 ")).wait_for()
        browser.close()
