"""One browser; tests are skipped, with the reason, where there is no browser or no built page."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from harness.page import DESKTOP, OpenPage, chromium, opened, what_is_missing
from harness.server import RunningServer
from tests.helpers.arm_record import ArmRecord, arm_record


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    missing = what_is_missing()
    if missing:
        pytest.skip(missing)
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> dict[str, str]:
    """The module's SETTINGS, and named states of its own, so that nothing is kept from another run."""
    folder: Path = tmp_path_factory.mktemp("data")
    own: dict[str, str] = getattr(request.module, "SETTINGS", {})
    return {"ARMBRIDGE_GOALS__NAMED_STATES_FILE": str(folder / "named_states.json"), **own}


@pytest.fixture(scope="module")
def server(settings: dict[str, str]) -> Iterator[RunningServer]:
    with RunningServer(settings=settings) as running:
        yield running


@pytest.fixture(scope="module")
def record(server: RunningServer) -> Iterator[ArmRecord]:
    with arm_record(server.url) as kept:
        yield kept


@pytest.fixture
def tab(browser: Browser) -> Iterator[OpenPage]:
    """An empty tab in which nothing goes wrong."""
    with opened(browser) as open_page:
        yield open_page
        assert open_page.errors == []


@pytest.fixture(scope="module")
def kept_page(browser: Browser, server: RunningServer) -> Iterator[OpenPage]:
    """A page of the server for all tests of a module."""
    with opened(browser) as open_page:
        open_page.open(server.port)
        yield open_page
        assert open_page.errors == []


@pytest.fixture(scope="session")
def routed_page(browser: Browser) -> Iterator[OpenPage]:
    with opened(browser, own=True) as open_page:
        yield open_page


@pytest.fixture
def routed(routed_page: OpenPage) -> Iterator[OpenPage]:
    """An empty tab, for tests that put themselves between page and server; the last route is the one that holds."""
    routed_page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    yield routed_page
    errors = list(routed_page.errors)
    routed_page.leave()
    assert errors == []


@pytest.fixture
def page(tab: OpenPage, server: RunningServer) -> OpenPage:
    """A page of the server."""
    tab.open(server.port)
    return tab
