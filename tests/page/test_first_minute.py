"""The first minute with the page: a motion at one click, a fault with its remedy, and nothing that cannot be done."""

import json
from typing import Any

from harness.clients import values_of
from harness.page import OpenPage
from harness.server import RunningServer


def is_hidden(page: OpenPage, test_id: str) -> bool:
    return not page.part(test_id).is_visible()


def test_a_server_of_another_version_says_so(routed: OpenPage, server: RunningServer) -> None:
    def with_other_version(operation: dict[str, Any]) -> dict[str, Any]:
        if operation.get("service") == "/arm/who_am_i":
            told = json.loads(operation["values"]["message"])
            operation["values"]["message"] = json.dumps({**told, "version": "99.0"})
        return operation

    routed.change_operations(with_other_version)
    routed.open(server.port)
    routed.until_text("notices", "The server is version 99.0")


def test_nothing_moves_by_the_page_while_the_arm_sinks_and_is_relaxed(routed: OpenPage, server: RunningServer) -> None:
    sinks = True

    def as_if_it_sank(operation: dict[str, Any]) -> dict[str, Any] | None:
        told = operation.get("topic") == "/arm/state" and values_of(operation["msg"])["mode"] == "relaxed"
        return None if sinks and told else operation

    routed.change_operations(as_if_it_sank)
    routed.open(server.port)
    routed.until_state("s.arm.mode === 'holding'")
    assert routed.part("gripper-open").is_enabled()
    routed.part("relax").click()
    routed.until_text("message", "it sinks")
    routed.until_text("state-pill", "RELAXING")
    for test_id in ("gripper-open", "gripper-close", "plan-and-move"):
        assert routed.part(test_id).is_disabled(), test_id
    routed.open_panel("drive")
    assert routed.part("jog-gripper-plus").is_disabled()
    sinks = False
    routed.open(server.port)
    routed.until_text("message", "The arm is relaxed")
    routed.open_panel("move")
    assert routed.part("gripper-open").is_disabled()
    routed.part("hold").click()
    routed.until("!document.querySelector('[data-testid=gripper-open]').matches(':disabled')")


def test_one_button_makes_the_first_motion_and_goes_for_good(page: OpenPage, server: RunningServer) -> None:
    page.until("!document.querySelector('[data-testid=first-motion]').hidden")
    before = page.joints()
    # Slow, until it has been seen that the arm moves.
    page.part("pace").fill("0.05")
    page.until_state("s.arm.speed_factor < 0.1")
    page.part("first-motion-go").click()
    page.until_offered("pause")
    page.until_text("time-left", "s left")
    page.part("pace").fill("1")
    page.until_state("s.goal.code === 1")
    after = page.joints()
    assert max(abs(after[name] - before[name]) for name in before) > 0.2
    assert is_hidden(page, "first-motion")
    page.open(server.port)
    page.until_state("s.arm.mode === 'holding'")
    assert is_hidden(page, "first-motion")


def test_the_next_step_is_told_where_the_buttons_are(page: OpenPage) -> None:
    page.until_text("next-step", "Choose where to go")
    assert not page.offers("go")
    page.part("named-home").click()
    page.until_text("next-step", "Plan shows the motion as a ghost")
    assert page.offers("plan")


def test_a_value_out_of_range_is_said_at_the_field_with_the_range_in_the_chosen_units(page: OpenPage) -> None:
    page.enter("target-x", "99999")
    page.until_text("target-x-problem", "x: 99999 mm is outside of -")
    page.open_panel("settings")
    page.part("units").select_option("rad")
    page.open_panel("move")
    page.until("document.querySelector('[data-testid=target-x]').getAttribute('aria-label') === 'target x in m'")


def test_a_relaxed_arm_says_so_and_holds_at_one_click(page: OpenPage) -> None:
    page.part("relax").click()
    page.until_text("message", "The arm is relaxed")
    page.part("hold").click()
    page.until_state("s.arm.mode === 'holding'")


def test_panels_open_and_close_by_the_rail_and_a_pinned_one_stays(page: OpenPage) -> None:
    focused = "document.activeElement.dataset.testid"
    page.part("close-panel-move").click()
    assert page.page.evaluate(focused) == "tab-move"
    assert is_hidden(page, "panel-move")
    page.page.keyboard.press("Enter")
    page.part("pin-panel-move").click()
    page.open_panel("plots")
    assert page.part("panel-move").is_visible()
    assert is_hidden(page, "tab-plots")
    page.open_panel("drive")
    assert is_hidden(page, "panel-plots")
    assert page.part("panel-move").is_visible()
    page.part("tab-drive").click()
    assert is_hidden(page, "panel-drive")


def test_a_double_click_takes_one_step_and_the_button_stays_where_it_is(page: OpenPage) -> None:
    # Slow enough to be paused on the way.
    page.part("speed").fill("0.05")
    page.part("named-extended").click()
    place = page.box("primary")
    page.until_offered("plan").dblclick()
    # A second click after the answer does not start the motion either.
    page.until_offered("go")
    second = """new MouseEvent("click", { detail: 2 })"""
    page.page.evaluate(f"() => document.querySelector('[data-testid=primary]').dispatchEvent({second})")
    assert page.state("pending_request") == "nothing"
    assert page.box("primary") == place
    page.press("go")
    assert page.until_offered("pause").bounding_box() == place
    page.press("pause")
    page.until_text("state-pill", "PAUSED")
    assert page.until_offered("resume").bounding_box() == place
    page.press("resume")
    page.until_text("state-pill", "EXECUTING")
    page.stop()
    page.until_text("state-pill", "STOPPED")
    assert page.page.title() == "STOPPED · armbridge"
