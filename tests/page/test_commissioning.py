"""Calibration and verification played on the page from the first question to the result, by a hand at the emulator."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.page import OpenPage, opened
from harness.server import EmulatorControl, ServerOnBus, server_on_bus
from robot.commissioning.session import asked_motions
from server.arm.setup import Description
from server.config import ArmSettings

NAME = "bench"

# Further than a joint must be moved by hand to tell its direction.
SHOWN_TICKS = 300

# A hand holds a joint as well as this.
HELD_TICKS = 20

ARM = Description.read(ArmSettings())
assert ARM.calibration is not None
JOINTS = {joint.joint: joint for joint in ARM.calibration.joints}


@pytest.fixture(scope="module")
def calibrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibrations")


@pytest.fixture(scope="module")
def arm(calibrations: Path) -> Iterator[ServerOnBus]:
    """A server with an emulated arm, for which lerobot has no calibration yet."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("HF_LEROBOT_CALIBRATION", str(calibrations))
        with server_on_bus() as running:
            yield running


@pytest.fixture
def page(browser: Browser, arm: ServerOnBus) -> Iterator[OpenPage]:
    with opened(browser) as open_page:
        open_page.open(arm.server.port)
        open_page.until_state("s.commissioning !== null")
        open_page.open_panel("arm", "commissioning")
        yield open_page


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


def test_an_arm_is_verified_on_the_page_in_every_pose(page: OpenPage, arm: ServerOnBus) -> None:
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
    assert page.errors == []


def test_an_arm_is_calibrated_on_the_page_into_a_file_of_lerobot(
    page: OpenPage, arm: ServerOnBus, calibrations: Path
) -> None:
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
    (file,) = calibrations.rglob(f"{NAME}.json")
    written = json.loads(file.read_text())
    assert written.keys() == JOINTS.keys()
    for name, joint in JOINTS.items():
        swept = written[name]["range_max"] - written[name]["range_min"]
        assert swept == pytest.approx(joint.range_max - joint.range_min, abs=2 * HELD_TICKS), name
        assert written[name]["drive_mode"] == 0, name
    assert page.errors == []
