"""The wall of a class: the teacher's page shows every student's arm, stops one, and ends its fault."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser
from websockets.sync.client import connect

from harness.clients import call_on, goal
from harness.page import opened
from tests.helpers.classroom import Room


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, tuple[str, str]]]:
    """Address and token of two students and the teacher by name, of a classroom that runs."""
    room = Room(tmp_path_factory.mktemp("lab"), 2)
    yield room.places
    room.end()


def test_the_teacher_sees_every_arm_and_stops_one(browser: Browser, places: dict[str, tuple[str, str]]) -> None:
    (url, token), (other, student_token) = places["teacher"], places["student02"]
    second = f"{other}/?token={token}"
    with opened(browser, draws=True) as page:
        page.open(int(url.rpartition(":")[2]), f"#token={token}")
        page.open_panel("class")
        for name in ("student01", "student02"):
            page.until_text(f"class-{name}-state", "IDLE")
            page.until(f"!document.querySelector('[data-testid=class-{name}] img').hidden")
        before = page.part("class-student02").locator("img").get_attribute("src")
        assert goal(second, "/moveit_goal_named", {"data": "extended"})["val"] == 1
        page.wait(lambda: page.part("class-student02").locator("img").get_attribute("src") != before)
        page.shot("class")
        page.part("class-student02-stop").click()
        page.until_state("s.classroom.find(each => each.name === 'student02').arm.last_stop !== ''")
        page.until("document.querySelector('[data-testid=class-student02] small').textContent !== ''")
        with connect(f"{other}/?token={student_token}") as student:
            # The student keeps the control.
            call_on(student, "/arm/relax")
            page.until_text("class-student02-state", "RELAXED")
            assert page.part("class-student01-state").text_content() == "IDLE"
            page.part("class-student02-reset").click()
            page.until_text("class-student02-state", "IDLE")
            page.wait(lambda: call_on(student, "/arm/take_control")["success"])
        page.part("close-panel-class").click()
        page.until_state("s.classroom.every(each => !each.connected)")
        assert page.errors == []


def test_a_student_sees_no_other_arm(browser: Browser, places: dict[str, tuple[str, str]]) -> None:
    url, token = places["student01"]
    with opened(browser) as page:
        page.open(int(url.rpartition(":")[2]), f"#token={token}")
        page.open_panel("class")
        page.until_text("class-hint", "administrator")
        assert page.part("class").locator("li").count() == 0
