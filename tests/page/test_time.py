"""What happened over time: plots, the timeline of goals, the log, and the health of bus and loop."""

import csv
import json
import sys
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from harness.clients import call, goal
from harness.page import DESKTOP, OpenPage, opened
from harness.server import FAST, RunningServer
from tests.helpers.programs import run

SETTINGS = FAST

JOINTS, NAMED = "/moveit_goal_joints", "/moveit_goal_named"

# Goals are drawn in the plot of positions.
QUANTITIES = ("position", "goal", "velocity", "error", "load", "temperature")

# Out of reach of every joint of the arm.
BEYOND_RAD = 9.0


@pytest.fixture(scope="module")
def page(kept_page: OpenPage) -> OpenPage:
    return kept_page


def move_pan(server: RunningServer, position_rad: float) -> None:
    answer = goal(server.url, JOINTS, {"name": ["shoulder_pan"], "position": [position_rad]})
    assert answer["val"] == 1, answer


def plot(name: str) -> str:
    """Return an expression for a figure of the plots."""
    return f"document.querySelector('[data-testid=plot]').dataset.{name}"


def choose(page: OpenPage, *quantities: str) -> None:
    """Have these quantities in the plots, and no other."""
    for each in QUANTITIES:
        page.part(f"plot-quantity-{each}").set_checked(each in quantities)


def test_plots_show_several_joints_and_save_them_as_csv(page: OpenPage, server: RunningServer, tmp_path: Path) -> None:
    page.open_panel("plots")
    choose(page, *QUANTITIES)
    page.until("document.querySelectorAll('[data-testid=plot] canvas').length === 5")
    move_pan(server, -0.6)
    move_pan(server, 0.6)
    page.until_state("Math.abs(s.joints.position_rad[s.joints.names.indexOf('shoulder_pan')] - 0.6) < 0.05")
    path = page.download("plot-csv", tmp_path)
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head[0] == "time [s]"
    assert {"shoulder_pan position [°]", "shoulder_pan goal [°]", "shoulder_lift load [%]"} <= set(head)
    times = [float(row[0]) for row in rows]
    assert times[0] == 0.0
    assert times == sorted(times)
    pan = [float(row[head.index("shoulder_pan position [°]")]) for row in rows]
    assert min(pan) < -30.0
    assert max(pan) > 30.0


def test_plots_stand_still_are_zoomed_and_go_on_live(page: OpenPage) -> None:
    page.open_panel("plots")
    page.until(f"Number({plot('samples')}) > 20")
    # There is something to go back to: more than a fifth of what the plots show.
    first_s = page.state("joints")["stamp"]
    page.until_state(f"s.joints.stamp > {first_s} + 5")
    page.part("plot-pause").click()
    page.until(f"{plot('endS')} !== ''")
    end_s, span_s = (page.page.evaluate(plot(name)) for name in ("endS", "spanS"))
    page.until_state(f"s.joints.stamp > {end_s} + 0.5")
    assert page.page.evaluate(plot("endS")) == end_s
    over = page.page.locator("[data-testid=plot] .u-over").first
    over.hover()
    page.page.mouse.wheel(0, -300)
    page.until(f"Number({plot('spanS')}) < {span_s}")
    page.until("document.querySelector('.plot-values').textContent.includes('shoulder_pan')")
    page.part("plot").focus()
    page.page.keyboard.press("ArrowLeft")
    page.until(f"Number({plot('endS')}) < {end_s}")
    page.page.keyboard.press("End")
    page.until(f"{plot('endS')} === ''")


def test_charts_fill_their_panel(page: OpenPage) -> None:
    page.open_panel("plots")
    page.until("document.querySelectorAll('[data-testid=plot] canvas').length > 0")
    choose(page, "position")
    page.until("document.querySelectorAll('[data-testid=plot] canvas').length === 1")
    # One chart takes what the choices leave, at any height of the window.
    page.page.set_viewport_size({"width": DESKTOP[0], "height": 1300})
    page.until("document.querySelector('[data-testid=plot] canvas').clientHeight > 500")
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    page.until("document.querySelector('[data-testid=plot] canvas').clientHeight < 300")


def test_plots_that_are_not_shown_are_not_drawn(page: OpenPage) -> None:
    page.open_panel("plots")
    page.until(f"Number({plot('draws')}) > 3")
    page.open_panel("log")
    drawn = page.page.evaluate(plot("draws"))
    stamp = page.state("joints")["stamp"]
    page.until_state(f"s.joints.stamp > {stamp} + 1")
    assert page.page.evaluate(plot("draws")) == drawn


def test_the_timeline_has_goals_of_other_clients_also_of_before_the_page_was_opened(
    browser: Browser, server: RunningServer, tmp_path: Path
) -> None:
    # From elsewhere: a goal where the arm stands has no ghost.
    move_pan(server, 0.0)
    move_pan(server, 0.3)
    refused = goal(server.url, JOINTS, {"name": ["shoulder_pan"], "position": [BEYOND_RAD]})
    assert refused["val"] == -16
    before, failed = _ids(server)[-2:]
    with opened(browser) as page:
        page.open(server.port)
        page.open_panel("goals")
        page.part(f"goal-open-{failed}").click()
        page.until_text(f"goal-open-{failed}", "shoulder_pan 515.7°: failed")
        page.until_text(f"goal-{failed}", "INVALID_GOAL_CONSTRAINTS")
        page.until_text(f"goal-{failed}", "shoulder_pan 515.7°")
        problem = page.download(f"goal-save-{failed}", tmp_path)
        page.part(f"goal-instead-{failed}").click()
        page.until("document.querySelectorAll('[data-testid=goal-history] > li').length > 2")
        # Also over: an arrival takes the plan away.
        there = "Math.abs(s.joints.position_rad[s.joints.names.indexOf('shoulder_pan')] - 1.92) < 0.05"
        page.until_state(f"s.active_goals.length === 0 && {there}")
        page.part(f"goal-open-{before}").click()
        page.until_text(f"goal-{before}", "planned in")
        page.part(f"goal-ghost-{before}").click()
        page.until_state("s.plan.trajectory !== null && s.plan.scrub_s > 0")
        assert page.errors == []
    asked = json.loads(problem.read_text())["goal_problems"][0]["goal"]["joints"]["positions_rad"]
    assert asked == {"shoulder_pan": pytest.approx(BEYOND_RAD)}
    planned = run(sys.executable, "-m", "server.cli", "plan", problem)
    assert planned.returncode == 0
    assert "1 of them failed as on the server" in planned.stdout
    assert "beyond its limits" in planned.stdout + planned.stderr


def _ids(server: RunningServer) -> list[str]:
    return [status["hardware_id"] for status in call(server.url, "/armbridge/goal_history")["goals"]]


def test_the_log_opens_with_the_lines_of_before(tab: OpenPage, server: RunningServer) -> None:
    move_pan(server, 0.3)
    tab.open(server.port)
    tab.open_panel("log")
    tab.until_text("log", "SUCCESS")


def test_the_log_is_filtered_and_stands_still_while_it_is_halted(page: OpenPage, server: RunningServer) -> None:
    page.open_panel("log")
    move_pan(server, 0.1)
    page.until_text("log", "SUCCESS")
    page.part("log-pause").click()
    text = page.part("log").text_content()
    move_pan(server, 0.2)
    page.part("log-new").wait_for()
    assert page.part("log").text_content() == text
    page.part("log-new").click()
    page.part("log-filter").fill("no such message")
    page.part("log-empty").wait_for()
    page.part("log-filter").fill("GOAL")
    page.until_text("log", "SUCCESS")


def test_health_of_bus_and_loop_is_in_words(page: OpenPage) -> None:
    page.open_panel("arm")
    # Loaded anew, the panel is shown before the first report comes.
    page.page.reload()
    page.until_text("health-loop", "ms late")
    page.until_text("health-bus", "simulated")
    page.until_text("health-latency", "ms")
