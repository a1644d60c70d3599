"""The page where others drive, and where not everybody may."""

from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import quote

import pytest
from playwright.sync_api import Browser, WebSocket
from websockets.sync.client import connect

from harness.clients import call_on
from harness.page import OpenPage, opened
from harness.server import RunningServer
from tests.helpers.robots import meshed_arm, small_stl

ADMIN, OPERATOR, OTHER, VIEWER = (f"{name}+secret/0123=" for name in ("admin", "operator", "other", "viewer"))


@pytest.fixture(scope="module")
def settings(settings: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "small.stl").write_bytes(small_stl())
    return {
        **settings,
        **meshed_arm(folder, "small.stl"),
        "ARMBRIDGE_ACCESS__ADMIN_TOKENS__HEAD": ADMIN,
        "ARMBRIDGE_ACCESS__OPERATE_TOKENS__ALICE": OPERATOR,
        "ARMBRIDGE_ACCESS__OPERATE_TOKENS__BOB": OTHER,
        "ARMBRIDGE_ACCESS__VIEW_TOKENS__SCREEN": VIEWER,
        "ARMBRIDGE_ACCESS__CONTROL_IDLE_S": "600",
    }


@contextmanager
def page_of(browser: Browser, server: RunningServer, token: str) -> Iterator[OpenPage]:
    with opened(browser) as page:
        page.open(server.port, f"#token={token}")
        page.until_state("s.identity !== null")
        yield page


def test_a_page_without_a_token_asks_for_one_and_tries_a_wrong_one_once(
    browser: Browser, server: RunningServer
) -> None:
    attempts: list[WebSocket] = []
    with opened(browser) as page:
        page.page.on("websocket", lambda socket: attempts.append(socket))
        page.goto(server.port)
        page.part("token").wait_for()
        page.until_text("link-pill", "not let in")
        page.part("token").fill("nobody's token, wrong")
        page.part("use-token").click()
        page.until_text("token-refused", "invalid token")
        page.part("token").fill(OPERATOR)
        page.page.keyboard.press("Enter")
        page.until_state("s.link.connected && s.identity?.role === 'operate'")
        page.until("window.armbridge.drawn.arm_ms > 0")
        assert page.part("token").is_hidden()
        # Without, with the wrong one, with the right one.
        assert len(attempts) == 3
        page.page.reload()
        page.until_state("s.link.connected && s.identity?.role === 'operate'")
        assert page.errors == []


def test_who_may_only_look_sees_why_and_can_stop(browser: Browser, server: RunningServer) -> None:
    with page_of(browser, server, VIEWER) as page:
        # Also the robot's files are asked for with the token.
        page.until("performance.getEntriesByType('resource').some(one => one.name.endsWith('small.stl'))")
        assert page.state("notices") == []
        assert page.page.url == f"http://127.0.0.1:{server.port}/"
        page.until_text("control", "Read only")
        page.part("named-home").click()
        for test_id in ("primary", "plan-and-move", "gripper-open", "relax", "save", "pace", "speed-limit"):
            assert page.part(test_id).is_disabled(), test_id
        page.stop()
        assert page.errors == []


def test_while_another_drives_the_page_says_who_and_can_plan_and_stop(browser: Browser, server: RunningServer) -> None:
    with page_of(browser, server, OPERATOR) as page:
        page.part("named-ready").click()
        with connect(f"{server.url}&token={quote(OTHER)}") as other:
            assert call_on(other, "/arm/take_control")["success"]
            page.until_text("control", "bob")
            page.until_text("control", "It is free in")
            for test_id in ("plan-and-move", "gripper-open", "relax", "pace", "take-control"):
                assert page.part(test_id).is_disabled(), test_id
            assert page.part("take-over").is_hidden()
            assert page.offers("plan")
            # It belongs to the operators, not to the one who drives.
            page.part("speed-limit").fill("0.25")
            page.until_text("speed-limit-text", "25 %")
            page.until_state("s.arm.speed_limit === 0.25")
            page.stop()
        page.until_text("control", "Nobody controls the arm")
        page.part("plan-and-move").click()
        page.until_text("control", "This page controls the arm")
        page.part("release-control").click()
        page.until_text("control", "Nobody controls the arm")
        assert page.errors == []


def test_an_administrator_takes_control_from_another(browser: Browser, server: RunningServer) -> None:
    with page_of(browser, server, ADMIN) as page, connect(f"{server.url}&token={quote(OTHER)}") as other:
        assert call_on(other, "/arm/take_control")["success"]
        page.until_text("control", "bob")
        page.part("take-over").click()
        page.until_text("control", "This page controls the arm")
        assert not call_on(other, "/arm/take_control")["success"]
