"""The list of servos, and the details of one."""

import functools
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from harness.clients import call
from harness.page import OpenPage, opened
from harness.server import ServerOnBus, server_on_bus
from harness.waiting import wait_until

# Above arm.warn_temperature_c, below arm.slow_temperature_c.
WARM_C = 57

# Bit of register STATUS for an overload.
OVERLOAD = 32

ELBOW, GRIPPER = "3", "6"


@pytest.fixture(scope="module")
def arm() -> Iterator[ServerOnBus]:
    with server_on_bus() as running:
        yield running


@pytest.fixture
def page(tab: OpenPage, arm: ServerOnBus) -> OpenPage:
    """A page with its list of servos open."""
    tab.open(arm.server.port)
    tab.open_panel("arm", "servos")
    tab.part("servo-open-elbow_flex").wait_for()
    return tab


def until_samples(page: OpenPage, more_than: int) -> int:
    """Wait for lines of more samples than some, and return how many there are."""
    samples = "Number(document.querySelector('[data-testid=servo-lines]').dataset.samples ?? 0)"
    page.until(f"{samples} > {more_than}")
    return int(page.page.evaluate(samples))


def test_choosing_a_servo_shows_its_registers_and_its_lines(page: OpenPage) -> None:
    assert page.part("servo-details").is_hidden()
    page.part("servo-open-shoulder_pan").click()
    page.until_text("servo-title", "shoulder_pan (servo 1)")
    page.until_text("servo-condition", "torque on")
    page.until_text("servo-registers", "P_GAIN")
    page.until("document.querySelectorAll('[data-testid=servo-details] canvas').length === 2")
    until_samples(page, until_samples(page, 0))
    page.part("servo-close").click()
    page.part("servo-details").wait_for(state="hidden")
    assert page.errors == []


def test_the_state_of_the_torque_is_told_in_the_language_of_the_page(browser: Browser, arm: ServerOnBus) -> None:
    with opened(browser, locale="de") as page:
        page.open(arm.server.port)
        page.open_panel("arm", "servos")
        page.part("servo-open-gripper").click()
        page.until_text("servo-condition", "Kraft an")
        page.part("servo-gripper").get_by_text("an", exact=True).wait_for()


def test_a_warm_servo_says_so_and_what_to_do_with_what_happened_before_the_page_was_opened(
    browser: Browser, arm: ServerOnBus
) -> None:
    arm.emulator.command(temperature={ELBOW: WARM_C})
    history = functools.partial(call, arm.server.url, "/arm/servo_history", {"joint": "elbow_flex"})
    wait_until(lambda: any("warm" in event for event in history()["events"]))
    with opened(browser) as page:
        page.open(arm.server.port)
        page.open_panel("arm", "servos")
        page.part("servo-open-elbow_flex").click()
        page.until_text("servo-events", "warning: warm")
        page.until_text("servo-advice", "Keep the arm relaxed while it is idle")
        assert page.part("servo-elbow_flex").get_attribute("data-level") == "warn"
        assert page.errors == []


def test_errors_are_counted_by_kind_with_what_to_do(page: OpenPage, arm: ServerOnBus) -> None:
    page.part("servo-open-gripper").click()
    page.until_text("servo-errors", "none")
    arm.emulator.command(status={GRIPPER: OVERLOAD})
    page.until_text("servo-errors", "overload: 1")
    page.until_text("servo-advice", "overload")
    arm.emulator.command(status={GRIPPER: 0})
    assert page.errors == []


def test_the_list_is_walked_by_the_keyboard_while_the_servos_report(page: OpenPage) -> None:
    first = page.part("servo-open-shoulder_pan")
    first.focus()
    page.page.keyboard.press("Enter")
    page.until_text("servo-title", "shoulder_pan")
    until_samples(page, until_samples(page, 0) + 1)
    page.page.keyboard.press("Tab")
    page.page.keyboard.press("Enter")
    page.until_text("servo-title", "shoulder_lift")
    assert page.part("servo-open-shoulder_lift").get_attribute("aria-expanded") == "true"
