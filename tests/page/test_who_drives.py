"""The page where others drive and look, and where not everybody may: tokens, control, codes for others, and a film."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import pytest
from playwright.sync_api import Browser, WebSocket
from websockets.sync.client import connect

from harness.clients import call_on, goal
from harness.page import PHONE, OpenPage, opened
from harness.server import RunningServer
from tests.helpers.robots import meshed_arm, small_stl

ADMIN, OPERATOR, OTHER, VIEWER = (f"{name}+secret/0123=" for name in ("admin", "operator", "other", "viewer"))


# Every WebM begins with the EBML header (RFC 8794, section 11.2.1).
EBML = bytes.fromhex("1a45dfa3")


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


@pytest.fixture(scope="module")
def server(settings: dict[str, str]) -> Iterator[RunningServer]:
    """A server on the network."""
    with RunningServer("--port 0 --host 0.0.0.0", settings) as running:
        yield running


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


def test_the_last_seconds_are_saved_as_a_film(browser: Browser, server: RunningServer, tmp_path: Path) -> None:
    with opened(browser, draws=True) as page:
        page.open(server.port, f"#token={ADMIN}")
        page.open_panel("settings")
        assert page.part("film-save").is_disabled()
        page.part("film-on").check()
        for pose in ("home", "ready"):
            assert goal(f"{server.url}&token={quote(ADMIN)}", "/moveit_goal_named", {"data": pose})["val"] == 1
        film = page.download("film-save", tmp_path).read_bytes()
        assert film.startswith(EBML)
        assert len(film) > 2000
        # The next one is filmed already.
        page.until("!document.querySelector('[data-testid=film-save]').disabled")
        page.part("film-on").uncheck()
        assert page.part("film-save").is_disabled()


def test_a_code_lets_a_page_in_that_only_looks(browser: Browser, server: RunningServer) -> None:
    with page_of(browser, server, ADMIN) as page:
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
    with page_of(browser, server, ADMIN) as page:
        page.open_panel("drive")
        page.page.locator("#section-phone > summary").click()
        page.part("phone-show-code").click()
        page.until_text("phone-note", "lets one phone in")
        page.until_text("phone-note", "not encrypted")
        address = page.part("phone-address").text_content() or ""
        assert finder_pattern(page) == [True, False, True, True, True, False, True]
        token = address.partition("#token=")[2]
        assert token not in ("", ADMIN)
        with opened(browser, PHONE, has_touch=True, is_mobile=True) as phone:
            phone.open(server.port, f"#token={token}")
            phone.until_state("s.identity?.role === 'operate'")
            with connect(f"ws://127.0.0.1:{server.port}") as other:
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
