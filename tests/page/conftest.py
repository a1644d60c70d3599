"""One browser, with a tab a module; tests are skipped, with the reason, where there is no browser or no built page."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from harness.page import OpenPage, chromium, opened, what_is_missing
from harness.server import RunningServer


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
def module_tab(browser: Browser) -> Iterator[OpenPage]:
    with opened(browser) as open_page:
        yield open_page


@pytest.fixture
def tab(module_tab: OpenPage) -> Iterator[OpenPage]:
    """An empty tab in which nothing goes wrong; nothing is kept from the page before."""
    yield module_tab
    errors = list(module_tab.errors)
    module_tab.leave()
    assert errors == []


@pytest.fixture
def page(tab: OpenPage, server: RunningServer) -> OpenPage:
    """A page of the server."""
    tab.open(server.port)
    return tab
