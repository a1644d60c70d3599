"""A server that goes away and comes back."""

import signal

from playwright.sync_api import Browser

from harness.page import opened
from harness.server import RunningServer


def test_the_page_comes_back_by_itself(browser: Browser, settings: dict[str, str]) -> None:
    with opened(browser) as page:
        with RunningServer(settings=settings) as first:
            port = first.port
            page.open(port)
            page.until_state("s.link.connected && s.joints.names.length > 0")
            page.part("named-home").click()
            page.press("plan")
            page.until_offered("go")
            first.end(signal.SIGKILL)
            page.until_state("!s.link.connected")
        assert page.part("primary").is_disabled()
        assert "grayscale" in page.part("view").evaluate("view => getComputedStyle(view).filter")
        page.part("stop").click()
        page.until_text("stop", "not acknowledged")
        stamp = page.state("joints.stamp")
        with RunningServer(f"--port {port}", settings):
            page.until_state(f"s.link.connected && s.joints.stamp > {stamp}")
            # Of the server before.
            assert not page.offers("go")
            page.part("named-ready").click()
            page.part("plan-and-move").click()
            page.until_state("s.goal.code === 1")
            assert page.errors == []
