"""The page on a phone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.helpers.page import PHONE, opened
from tests.helpers.server import RunningServer

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_arm_and_stop_without_scrolling_sideways(
    browser: Browser, server: RunningServer, scheme: str
) -> None:
    with opened(browser, PHONE, has_touch=True, is_mobile=True, color_scheme=scheme) as page:
        page.open(server.port)
        page.until("window.armbridge.drawn.frames > 3")
        page.shot(f"phone_{scheme}")
        assert page.page.evaluate("document.documentElement.scrollWidth") <= PHONE[0]
        for test_id in ("stop", "state-pill", "link-pill"):
            box = page.box(test_id)
            assert 0 <= box["x"] <= box["x"] + box["width"] <= PHONE[0]
            assert 0 <= box["y"] <= box["y"] + box["height"] <= PHONE[1]
        page.page.mouse.wheel(0, 2000)
        page.part("stop").tap()
        page.until_text("stop", "acknowledged")
        assert page.errors == []
