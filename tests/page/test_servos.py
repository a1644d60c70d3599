"""The panel of the arm on emulated servos: their list and details, verification, and calibration by a hand.

The procedures are played from the first question to the result.
"""

import functools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.clients import call
from harness.page import OpenPage, opened
from harness.server import EmulatorControl, ServerOnBus, server_on_bus
from harness.waiting import wait_until
from robot.commissioning.session import asked_motions
from server.arm.setup import Description
from server.config import ArmSettings

# Above arm.warn_temperature_c, below arm.slow_temperature_c.
WARM_C = 57

# Bit of register STATUS for an overload.
OVERLOAD = 32

ELBOW, GRIPPER = "3", "6"

NAME = "bench"

# Further than a joint must be moved by hand to tell its direction.
SHOWN_TICKS = 300

# A hand holds a joint as well as this.
HELD_TICKS = 20

ARM = Description.read(ArmSettings())
assert ARM.calibration is not None
JOINTS = {joint.joint: joint for joint in ARM.calibration.joints}


@pytest.fixture(scope="module")
def arm() -> Iterator[ServerOnBus]:
    with server_on_bus() as running:
        yield running


@pytest.fixture
def uncalibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServerOnBus]:
    """A server of its own, for whose arm lerobot has no calibration yet: another server runs after the calibration."""
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    with server_on_bus() as running:
        yield running


@pytest.fixture
def holding(arm: ServerOnBus) -> ServerOnBus:
    assert call(arm.server.url, "/arm/enable")["success"]
    return arm


@pytest.fixture
def page(tab: OpenPage, holding: ServerOnBus) -> OpenPage:
    """A page with its list of servos open."""
    tab.open(holding.server.port)
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


def test_the_state_of_the_torque_is_told_in_the_language_of_the_page(browser: Browser, holding: ServerOnBus) -> None:
    with opened(browser, locale="de") as page:
        page.open(holding.server.port)
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


def test_errors_are_counted_by_kind_with_what_to_do(page: OpenPage, arm: ServerOnBus) -> None:
    page.part("servo-open-gripper").click()
    page.until_text("servo-errors", "none")
    arm.emulator.command(status={GRIPPER: OVERLOAD})
    page.until_text("servo-errors", "overload: 1")
    page.until_text("servo-advice", "overload")
    arm.emulator.command(status={GRIPPER: 0})
    page.wait(lambda: call(arm.server.url, "/arm/reset_fault")["success"])


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


def open_procedures(page: OpenPage, arm: ServerOnBus) -> None:
    page.open(arm.server.port)
    page.until_state("s.commissioning !== null")
    page.open_panel("arm", "commissioning")


def commissioning(page: OpenPage) -> dict[str, Any]:
    """Return the procedure as the page has it."""
    state: dict[str, Any] = page.state("commissioning")
    return state


def answer(page: OpenPage, text: str) -> None:
    """Press an answer of the present step, and wait for what the server makes of it."""
    step = commissioning(page)["step"]
    page.part("answers").get_by_role("button", name=text, exact=True).click()
    page.until_state(f"s.commissioning.step !== {json.dumps(step)} || s.notices.length > 0")


def move_by_hand(page: OpenPage, emulator: EmulatorControl, ticks: Mapping[str, int]) -> None:
    """Move joints by hand, and wait until the page shows them there [ticks]."""
    emulator.command(hand={str(JOINTS[name].servo_id): at for name, at in ticks.items()})
    for name, at in ticks.items():
        present = f"s.commissioning.joints.find(each => each.joint === '{name}').present"
        # Positions count on across the seam.
        off = f"((({present} - {at}) % 4096) + 4096 + 2048) % 4096 - 2048"
        page.until_state(f"Math.abs({off}) < {HELD_TICKS}")


def middle(name: str) -> int:
    return (JOINTS[name].range_min + JOINTS[name].range_max) // 2


def show_direction(page: OpenPage, emulator: EmulatorControl, name: str) -> None:
    """Move a joint as the step asks."""
    rises = asked_motions(ARM.robot)[name].rises
    sign = JOINTS[name].servo.sign * (1 if rises else -1)
    present = next(each for each in commissioning(page)["joints"] if each["joint"] == name)["present"]
    move_by_hand(page, emulator, {name: (present + sign * SHOWN_TICKS) % 4096})


def test_an_arm_is_verified_on_the_page_in_every_pose(tab: OpenPage, arm: ServerOnBus) -> None:
    page = tab
    open_procedures(page, arm)
    page.part("verify").click()
    page.until_state("s.commissioning.step === 'torque'")
    answer(page, "Move")
    compared = []
    while commissioning(page)["procedure"]:
        page.until_state("s.commissioning.procedure === '' || s.commissioning.answers.length > 0")
        state = commissioning(page)
        if not state["procedure"]:
            break
        compared.append(state["step"])
        page.until_text("swept-elbow_flex-droop", "°")
        answer(page, "Yes")
    assert len(compared) >= 3
    page.until_text("procedure-result", "he arm looks as the model")
    assert page.part("findings").is_hidden()


def test_an_arm_is_calibrated_on_the_page_into_a_file_of_lerobot(
    tab: OpenPage, uncalibrated: ServerOnBus, tmp_path: Path
) -> None:
    page, arm = tab, uncalibrated
    open_procedures(page, arm)
    page.part("calibration-name").fill(NAME)
    page.part("calibrate").click()
    page.until_state("s.commissioning.step === 'hold'")
    page.until_text("procedure", "Calibration in progress")
    answer(page, "Relax the arm")
    page.until_state("s.commissioning.step === 'sweep' && s.arm.mode === 'relaxed'")
    for ends in ("range_min", "range_max"):
        move_by_hand(page, arm.emulator, {name: getattr(joint, ends) for name, joint in JOINTS.items()})
    page.until_text("swept-elbow_flex-done", "done")
    # A page that is loaded again goes on where it was.
    page.page.reload()
    page.until_state("s.commissioning?.step === 'sweep' && s.commissioning.joints.every(each => each.done)")
    move_by_hand(page, arm.emulator, {name: middle(name) for name in JOINTS})
    answer(page, "Done")
    while (step := commissioning(page)["step"]) != "write":
        kind, _, name = step.partition(" of ")
        if kind == "direction":
            show_direction(page, arm.emulator, name)
        else:
            assert kind == "middle", commissioning(page)
        answer(page, "Done")
        assert page.state("notices") == []
    assert commissioning(page)["findings"] == []
    page.until_state("s.joint_in_hand !== null")
    answer(page, "Write")
    page.until_text("procedure-result", "The calibration is in the servos")
    page.until_state("s.link.connected && s.arm.mode === 'relaxed'")
    (file,) = tmp_path.rglob(f"{NAME}.json")
    written = json.loads(file.read_text())
    assert written.keys() == JOINTS.keys()
    for name, joint in JOINTS.items():
        swept = written[name]["range_max"] - written[name]["range_min"]
        assert swept == pytest.approx(joint.range_max - joint.range_min, abs=2 * HELD_TICKS), name
        assert written[name]["drive_mode"] == 0, name
