"""Motions shown by hand on the page: recorded, listed, replayed, cut, renamed and deleted, on the emulated arm."""

from collections.abc import Iterator

import pytest

from harness.clients import call
from harness.page import SHARED, OpenPage
from harness.server import FAST, ServerOnBus, server_on_bus
from tests.helpers.robots import nominal_calibration
from tests.page.test_sequence import watched, went_through

ELBOW = next(joint for joint in nominal_calibration().joints if joint.joint == "elbow_flex")

# Servos carry the arm's weight, and have backlash [rad].
ARRIVED = 0.06


@pytest.fixture(scope="module")
def arm() -> Iterator[ServerOnBus]:
    settings = {key.removeprefix("ARMBRIDGE_"): value for key, value in {**FAST, **SHARED}.items()}
    with server_on_bus(**settings) as running:
        yield running


@pytest.fixture
def page(tab: OpenPage, arm: ServerOnBus) -> OpenPage:
    tab.open(arm.server.port)
    tab.until_state("s.teaching.motions !== null && s.joints.names.length > 0")
    tab.open_panel("sequence", "teaching")
    return tab


def lead_elbow(page: OpenPage, arm: ServerOnBus, position_rad: float) -> None:
    """Move the elbow by hand, and wait until the page shows it there."""
    arm.emulator.command(hand={str(ELBOW.servo_id): ELBOW.ticks_from_rad(position_rad)})
    until_elbow(page, position_rad, 0.02)


def until_elbow(page: OpenPage, position_rad: float, within_rad: float = ARRIVED) -> None:
    at = "s.joints.position_rad[s.joints.names.indexOf('elbow_flex')]"
    page.until_state(f"Math.abs({at} - {position_rad}) < {within_rad}")


def show(page: OpenPage, arm: ServerOnBus, name: str) -> None:
    """Show a motion by hand: the elbow from 0 to 0.6 and back to 0.2 rad."""
    assert call(arm.server.url, "/arm/relax")["success"]
    page.until_state("s.arm.mode === 'relaxed'")
    lead_elbow(page, arm, 0.0)
    page.part("teach-name").fill(name)
    page.part("teach-begin").click()
    page.part("teach-recording").wait_for()
    lead_elbow(page, arm, 0.6)
    lead_elbow(page, arm, 0.2)
    page.part("teach-end").click()
    page.until_state(f"s.teaching.motions.includes('{name}')")
    page.until_text("teach-told", "it touches nothing")


def hold(page: OpenPage, arm: ServerOnBus) -> None:
    assert call(arm.server.url, "/arm/enable")["success"]
    page.until_state("s.arm.mode === 'holding'")
    arm.emulator.command(hand={str(ELBOW.servo_id): None})


def test_a_motion_is_recorded_and_replayed_backwards_and_forwards(page: OpenPage, arm: ServerOnBus) -> None:
    show(page, arm, "lift")
    hold(page, arm)
    page.enter("replay-speed", "200")
    page.part("replay-reverse").check()
    page.part("replay-lift").click()
    page.until_text("teach-told", "the arm has followed the motion")
    until_elbow(page, 0.0)
    page.part("replay-reverse").uncheck()
    page.part("replay-lift").click()
    until_elbow(page, 0.2)
    page.until_text("teach-told", "the arm has followed the motion")


def test_a_motion_is_a_row_of_a_sequence_and_is_replayed_with_it(page: OpenPage, arm: ServerOnBus) -> None:
    show(page, arm, "row")
    hold(page, arm)
    page.part("add-motion-row").click()
    page.until_text("teach-told", "“row” is in the sequence")
    page.part("add-here").click()
    page.until_state("s.sequence.checks.length === 2 && s.sequence.checks.every(c => c.verdict === 'possible')")
    rows = page.state("sequence.waypoints")
    assert [row["motion"] and row["motion"]["name"] for row in rows] == ["row", None]
    assert rows[0]["motion"]["start_rad"]["elbow_flex"] == pytest.approx(0.0, abs=ARRIVED)
    with watched(arm.server) as until:
        page.part("play-sequence").click()
        until(went_through({"elbow_flex": 0.6}, {"elbow_flex": 0.2}))
    page.until_state("s.sequence.playing === null && s.sequence.result !== ''")
    assert "2" in page.state("sequence.result")
    assert page.joints()["elbow_flex"] == pytest.approx(rows[1]["joints_rad"]["elbow_flex"], abs=ARRIVED)


def test_a_motion_becomes_waypoints_that_can_be_edited(page: OpenPage, arm: ServerOnBus) -> None:
    show(page, arm, "points")
    hold(page, arm)
    page.part("waypoints-of-points").click()
    page.until_state("s.sequence.waypoints.length >= 3")
    elbow = [row["joints_rad"]["elbow_flex"] for row in page.state("sequence.waypoints")]
    assert elbow[0] == pytest.approx(0.0, abs=ARRIVED)
    assert max(elbow) == pytest.approx(0.6, abs=ARRIVED)
    assert elbow[-1] == pytest.approx(0.2, abs=ARRIVED)
    page.part("waypoint-2-remove").click()
    page.until_state(f"s.sequence.waypoints.length === {len(elbow) - 1}")


def test_a_motion_is_cut_renamed_and_deleted(page: OpenPage, arm: ServerOnBus) -> None:
    show(page, arm, "long")
    page.part("edit-motion-long").click()
    page.part("motion-editor").wait_for()
    whole_s = page.state("teaching.edited.duration_s")
    page.enter("trim-to", f"{whole_s / 2:.2f}")
    page.part("trim-motion").click()
    page.until_text("teach-told", "lasts")
    page.part("edit-motion-long").click()
    page.until_state("s.teaching.edited !== null")
    assert page.state("teaching.edited.duration_s") == pytest.approx(whole_s / 2, abs=0.02)
    page.part("new-motion-name").fill("short")
    page.part("rename-motion").click()
    page.until_state("s.teaching.motions.includes('short') && !s.teaching.motions.includes('long')")
    page.part("edit-motion-short").click()
    page.part("delete-motion").click()
    page.part("delete-motion").click()
    page.until_state("!s.teaching.motions.includes('short')")


def test_a_recording_that_is_discarded_is_no_motion(page: OpenPage) -> None:
    page.part("teach-name").fill("nothing")
    page.part("teach-begin").click()
    page.part("teach-discard").click()
    page.until_text("teach-told", "the recording of 'nothing' is discarded")
    assert "nothing" not in page.state("teaching.motions")


def test_a_name_that_cannot_be_used_is_said_with_the_reason(page: OpenPage) -> None:
    page.part("teach-name").fill("a/b")
    page.part("teach-begin").click()
    page.until_text("teach-told", "name")
    assert page.state("teaching.recording") is None


def test_axe_finds_nothing_among_motions(page: OpenPage, arm: ServerOnBus) -> None:
    if "lift" not in page.state("teaching.motions"):
        show(page, arm, "lift")
    page.part("edit-motion-lift").click()
    page.part("motion-editor").wait_for()
    assert page.violations() == []
