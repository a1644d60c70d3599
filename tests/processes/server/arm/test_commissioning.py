"""Commissioning by a client, on the emulated arm: the sweep of a hand, and the new start."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from harness.clients import ArmClient, arm_client, values_of
from harness.server import ServerOnBus, server_on_bus
from harness.waiting import TIMEOUT_S, until
from robot.calibration import Calibration, save
from server.arm.commissioning import ANSWER, BEGIN, CANCEL, STATE_TOPIC
from tests.helpers.robots import SO101_SERVOS, nominal_calibration
from tests.helpers.systemd import Systemd
from tests.server.conftest import FAST

TYPE = "armbridge_msgs/CommissioningState"
STOPS = {joint.servo_id: (joint.range_min, joint.range_max) for joint in nominal_calibration().joints}
ROLL, GRIPPER = 5, 6
MIDDLE = 2040


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lerobot")


@pytest.fixture(scope="module")
def arm(files: Path, systemd: Systemd) -> Iterator[ServerOnBus]:
    """A server of its own, as a service of systemd: the arm is calibrated here."""
    save(nominal_calibration(), files / "present.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_LEROBOT_CALIBRATION", str(files))
        patch.setenv("NOTIFY_SOCKET", systemd.address)
        with server_on_bus(**FAST, ARM__CALIBRATION=str(files / "present.json")) as running:
            yield running


@asynccontextmanager
async def admin(arm: ServerOnBus) -> AsyncIterator[ArmClient]:
    async with arm_client(arm.server.url) as client:
        await client.say("subscribe", topic=STATE_TOPIC, type=TYPE)
        yield client


def latest(client: ArmClient) -> dict[str, Any]:
    return client.topics[STATE_TOPIC][-1]


async def until_step(client: ArmClient, begins: str) -> dict[str, Any]:
    await client.until(STATE_TOPIC, lambda states: states[-1]["step"].startswith(begins))
    return latest(client)


async def answer(client: ArmClient, text: str) -> dict[str, Any]:
    return await client.call(ANSWER, step=latest(client)["step"], answer=text)


async def move_by_hand(client: ArmClient, arm: ServerOnBus, ticks: dict[int, int]) -> None:
    arm.emulator.command(hand={str(servo): at for servo, at in ticks.items()})
    names = {servo.joint: servo.servo_id for servo in SO101_SERVOS}

    def there(states: list[dict[str, Any]]) -> bool:
        present = {names[each["joint"]]: each["present"] for each in states[-1]["joints"]}
        return all(abs(present[servo] - at) < 3 for servo, at in ticks.items())

    await client.until(STATE_TOPIC, there)


async def begin_sweep(client: ArmClient) -> None:
    assert (await client.call(BEGIN, procedure="calibrate", name=""))["success"]
    await until_step(client, "hold")
    assert (await answer(client, "relax the arm"))["success"]
    await until_step(client, "sweep")


async def ended(client: ArmClient) -> str:
    await client.until(STATE_TOPIC, lambda states: states[-1]["procedure"] == "" and bool(states[-1]["result"]))
    return str(latest(client)["result"])


async def cancelled(client: ArmClient) -> None:
    assert (await client.call(CANCEL))["success"]
    assert "cancelled" in await ended(client)


async def refused(client: ArmClient, service: str, says: str, **request: str) -> None:
    answer = await client.call(service, **request)
    assert (answer["success"], says in answer["message"]) == (False, True), answer


async def test_one_procedure_is_in_progress_at_a_time_and_outlives_its_client(arm: ServerOnBus) -> None:
    async with admin(arm) as client:
        assert (await client.until(STATE_TOPIC, bool))[-1]["procedure"] == ""
        await refused(client, ANSWER, BEGIN, step="sweep", answer="done")
        await refused(client, BEGIN, "no procedure 'dance'", procedure="dance", name="")
        await refused(client, BEGIN, "is no name", procedure="calibrate", name="../../etc/passwd")
        assert (await client.call(BEGIN, procedure="verify", name=""))["success"]
    async with admin(arm) as other:
        await until_step(other, "torque")
        await refused(other, BEGIN, "verify is in progress", procedure="calibrate", name="")
        await cancelled(other)


async def test_a_late_click_answers_nothing_else_and_an_arm_that_is_switched_on_ends_it(arm: ServerOnBus) -> None:
    async with admin(arm) as client:
        await begin_sweep(client)
        await refused(client, ANSWER, "the present one is 'sweep'", step="hold", answer="relax the arm")
        assert not (await answer(client, "write"))["success"]
        await cancelled(client)
        assert values_of((await client.until("/arm/state", bool))[-1])["mode"] == "relaxed"
        await begin_sweep(client)
        assert (await client.call("/arm/enable"))["success"]
        assert "switched on meanwhile" in await ended(client)


async def test_the_calibration_of_a_swept_arm_is_used_at_once(arm: ServerOnBus, files: Path, systemd: Systemd) -> None:
    swept = [servo for servo in STOPS if servo != ROLL]
    async with admin(arm) as client:
        await begin_sweep(client)
        # The emulated elbow's lower stop is in the way of nothing, so that its range is another than before.
        arm.emulator.command(obstacle={"3": STOPS[3][0] + 200})
        stops = {s: STOPS[s][0] + 200 * (s == 3) for s in swept}, {s: STOPS[s][1] for s in swept}
        # A range so short counts where both of its ends are met twice.
        for servo_stops in stops * 2:
            await move_by_hand(client, arm, servo_stops)
        await move_by_hand(client, arm, dict.fromkeys(STOPS, MIDDLE))
        assert (await answer(client, "done"))["success"]
        await until_step(client, "middle of wrist_roll")
        assert (await answer(client, "done"))["success"]
        while not latest(client)["step"].startswith("direction of gripper"):
            step = latest(client)["step"]
            await client.call(ANSWER, step=step, answer="skip")
            await client.until(STATE_TOPIC, lambda states, step=step: states[-1]["step"] != step)
        # A gripper whose servo falls when it opens.
        await move_by_hand(client, arm, {GRIPPER: MIDDLE - 400})
        assert (await answer(client, "done"))["success"]
        state = await until_step(client, "write")
        assert any("gripper is mirrored" in finding for finding in state["findings"])
        assert (await answer(client, "write"))["success"]
        assert "the arm is relaxed, and uses it from now on" in await ended(client)
    calibration = Calibration.load(files / "present.json", SO101_SERVOS)
    elbow, gripper = calibration.joints[2], calibration.joints[-1]
    assert elbow.range_max - elbow.range_min == pytest.approx(STOPS[3][1] - STOPS[3][0] - 200, abs=3)
    assert elbow.homing_offset == pytest.approx(100, abs=3)
    assert gripper.drive_mode == 1
    await until(lambda: sum("armbridge is ready" in line for line in arm.server.lines) == 2)
    # Systemd ends a service that says that it stops, and one that falls silent.
    assert systemd.has_heard("READY=1", times=2)
    assert "STOPPING=1" not in systemd.heard
    async with admin(arm) as client:
        # What the server before has found is still shown, and the arm stands where the hand left it.
        await client.until(STATE_TOPIC, lambda states: "Verify it" in states[-1]["result"])
        await client.until_mode("relaxed")
        # By its weight the elbow sinks until it is held again.
        arm.emulator.command(hand={"3": MIDDLE - elbow.homing_offset})
        elbow_rad = elbow.rad_from_ticks(MIDDLE - elbow.homing_offset)
        async with asyncio.timeout(TIMEOUT_S):
            while abs((positions := await client.positions())["elbow_flex"] - elbow_rad) > 0.02:
                pass
        assert positions["gripper"] == pytest.approx(
            gripper.rad_from_ticks(MIDDLE - 400 - gripper.homing_offset), abs=0.02
        )
        limits = (await client.until("/arm/joint_limits", bool))[-1]["limits"]
        upper = next(each["max_position"] for each in limits if each["joint_name"] == "elbow_flex")
        assert upper < elbow.upper_rad
        arm.emulator.command(hand={"3": None})
