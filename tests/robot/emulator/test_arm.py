"""Emulated arms: servos, the weight of their links, and the adapter that the arm process reads them by."""

import contextlib
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import Calibration
from robot.description import model
from robot.emulator.arm import MAX_WAITING_BYTES, EmulatedArm, LinkWeights, weight_of
from robot.emulator.control import LiveCommand
from robot.emulator.feetech import DUTY_PERMILLE_PER_NM, build_servos
from robot.errors import NoReply, StartupError
from robot.hardware.feetech.registers import TELEMETRY
from robot.hardware.interface import HardwareInterface, run_to_end
from robot.hardware.port import LOCAL_LATENCY_S
from tests.helpers import arm_rig, dynamixel
from tests.helpers.dynamixel import emulated_arm
from tests.helpers.emulator import ALL, IDS, PING, REQUESTS, SYNC_READ, SteppedClock, SteppedEmulator, packet
from tests.helpers.resources import examples
from tests.helpers.robots import SO101_SERVOS, so101

CALIBRATIONS = {"feetech": arm_rig.CALIBRATION, "dynamixel": dynamixel.CALIBRATION}
OF_BOTH_FAMILIES = pytest.mark.parametrize("kind", CALIBRATIONS)


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


def position_rad(hardware: HardwareInterface) -> np.ndarray:
    return hardware.read().position_rad


def found(arm: EmulatedArm[Any]) -> Any:
    return run_to_end(arm.open().survey())


@OF_BOTH_FAMILIES
def test_servos_start_relaxed_where_they_are_put_inside_their_mechanical_stops(kind: str, clock: SteppedClock) -> None:
    source = emulated_arm(kind, clock, start_rad={"shoulder_lift": -0.5, "gripper": 9.0})
    stand = {"shoulder_lift": -0.5, "gripper": CALIBRATIONS[kind].joints[5].upper_rad}
    expected = [stand.get(joint.joint, 0.0) for joint in CALIBRATIONS[kind].joints]
    assert position_rad(source.open()) == pytest.approx(expected, abs=0.002)
    assert not found(source).driven.any()


@OF_BOTH_FAMILIES
def test_driven_servos_hold_also_while_the_hardware_is_closed(kind: str, clock: SteppedClock) -> None:
    source = emulated_arm(kind, clock, start_rad={"shoulder_lift": -0.5}, driven=True)
    hardware = source.open()
    before = position_rad(hardware)
    for _ in range(50):
        clock.advance(0.01)
        after = position_rad(hardware)
    assert after == pytest.approx(before, abs=0.03)
    hardware.close()
    assert found(source).driven.all()
    assert [servo.torque_limit_permille for servo in source.bus.servos] == pytest.approx([800] * 5 + [500], abs=1)


def lost_replies(source: EmulatedArm[Any], clock: SteppedClock) -> list[int]:
    """Replies that are missing in each of some cycles."""
    hardware = source.open()
    counters = hardware.counters
    lost = []
    for _ in range(50):
        clock.advance(0.01)
        before = counters.timeouts
        hardware.read()
        lost.append(counters.timeouts - before)
    return lost


@OF_BOTH_FAMILIES
def test_replies_are_lost_or_damaged_as_configured_and_alike_for_a_seed(kind: str, clock: SteppedClock) -> None:
    assert sum(lost_replies(emulated_arm(kind, clock), clock)) == 0
    assert 10 < sum(lost_replies(emulated_arm(kind, clock, corrupt=0.1), clock)) < 60
    first, again, other = (lost_replies(emulated_arm(kind, clock, drop=0.1, seed=seed), clock) for seed in (3, 3, 4))
    assert 10 < sum(first) < 60
    assert first == again != other


def test_only_servos_that_were_there_before_go_on_with_their_record(clock: SteppedClock, write_log: Path) -> None:
    for resumes, lines in ((True, ["{}"]), (False, [])):
        write_log.write_text("{}\n")
        with contextlib.closing(emulated_arm("feetech", clock, write_log=write_log, resumes=resumes).bus.log):
            assert write_log.read_text().splitlines() == lines


def test_servos_with_a_shifted_zero_start_relaxed_and_are_refused_torque(clock: SteppedClock) -> None:
    hardware = emulated_arm("feetech", clock, population="ros2_driver", driven=True).open()
    run_to_end(hardware.survey())
    assert not run_to_end(hardware.driven()).any()
    with pytest.raises(StartupError, match="the zero has shifted since the calibration at shoulder_pan"):
        run_to_end(hardware.enable(range(6)))


def gravity_permille(calibration: Calibration, pose: list[float]) -> list[float]:
    servos = build_servos(calibration, pose)
    weight_of(so101(), calibration, servos)()
    return [servo.plant.gravity_permille for servo in servos]


def test_the_weight_follows_the_pose_whatever_the_offsets_and_loads_a_servo_whose_ticks_fall_the_other_way() -> None:
    shifted = [replace(each, homing_offset=-120, range_min=900, range_max=3000) for each in arm_rig.CALIBRATION.joints]
    pose = [0.0, 0.7, -0.4, 0.3, 0.0, 0.5]
    joints = [servo.joint for servo in SO101_SERVOS]
    torques_nm = LinkWeights(so101()).holding_torques(dict(zip(joints, pose, strict=True)))
    expected = [DUTY_PERMILLE_PER_NM * torques_nm[joint] for joint in joints]
    assert gravity_permille(Calibration(tuple(shifted)), pose) == pytest.approx(expected, abs=0.1)
    mirrored = [replace(servo, sign=-1) for servo in SO101_SERVOS]
    plain, other = (gravity_permille(Calibration.nominal(servos), pose) for servos in (SO101_SERVOS, mirrored))
    assert abs(plain[1]) > 1.0
    assert other == pytest.approx([-permille for permille in plain], abs=0.1)


with warnings.catch_warnings(action="ignore"):  # of its own imports
    import pinocchio

ANGLE = st.floats(-1.6, 1.6)

HOIST_URDF = """
<robot name="hoist">
  <link name="base"/>
  <link name="load"><inertial><origin xyz="0.1 0 0"/><mass value="2"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="load"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""
HOIST_SRDF = '<robot name="hoist"><group name="arm"><joint name="lift"/></group></robot>'


@given(st.lists(ANGLE, min_size=6, max_size=6))
def test_a_torque_is_the_gradient_of_the_links_energy_and_a_prismatic_joint_carries_all_that_hangs_on_it(angles):
    robot = so101()
    pin = pinocchio.buildModelFromXML(robot.urdf)
    position = np.zeros(pin.nq)
    by_name = dict(zip((joint.name for joint in robot.movable_joints), angles, strict=True))
    for name, angle in by_name.items():
        position[pin.joints[pin.getJointId(name)].idx_q] = angle
    expected = pinocchio.computeGeneralizedGravity(pin, pin.createData(), position)
    for name, torque in LinkWeights(robot).holding_torques(by_name).items():
        assert torque == pytest.approx(expected[pin.joints[pin.getJointId(name)].idx_v], abs=1e-6)
    hoist = model.parse(HOIST_URDF, HOIST_SRDF)
    assert LinkWeights(hoist).holding_torques({"lift": 0.3}) == {"lift": pytest.approx(19.62)}


# An example of each command that takes no time, and some that end what others began.
COMMANDS = [
    *({name: field.examples[0]} for name, field in LiveCommand.model_fields.items() if "delay" not in name),
    *({"drop": 0.0}, {"status": {"3": 0}}, {"hand": {"1": None}}, {"obstacle": {"1": None}}, {"frozen": False}),
]

BLOCK_READ = packet(ALL, SYNC_READ, [TELEMETRY.address, TELEMETRY.length, *IDS])
STEP_S = 0.01


@pytest.fixture
def at_once() -> SteppedEmulator:
    """Servos on a wire that takes no time, as in the arm process."""
    return SteppedEmulator(wire_time=False)


@examples(40)
@given(
    st.lists(
        st.one_of(
            REQUESTS,
            st.sampled_from([0.02, 0.1, 1.0]),
            st.sampled_from(COMMANDS),
        ),
        max_size=15,
    )
)
def test_the_packets_are_those_of_a_bus_whose_bytes_take_their_time(events: list[Any]) -> None:
    with_wire, without = SteppedEmulator(wire_time=True), SteppedEmulator(wire_time=False)
    for event in events:
        heard = []
        for emulator in (with_wire, without):
            if isinstance(event, bytes):
                emulator.port.writePort(event)
            elif isinstance(event, dict):
                emulator.command(**event)
            else:
                emulator.clock.advance(event)
            # Long enough for all that can be on the wire.
            emulator.clock.advance(2 * STEP_S)
            heard.append(emulator.port.receive(0.0))
        assert heard[0] == heard[1]


def test_replies_are_there_at_once_one_that_does_not_come_is_not_waited_for_and_no_time_passes(at_once):
    started_s = at_once.clock()
    at_once.port.writePort(BLOCK_READ)
    assert len(at_once.port.receive(1.0)) == 6 * (TELEMETRY.length + 6)
    with pytest.raises(NoReply):
        at_once.open_bus().ping(9)
    assert at_once.clock() == started_s
    # Nor do USB frames delay a reply.
    at_once.clock.advance(0.0001)
    at_once.command(usb_frame_ms=1)
    assert len(at_once.open_bus().sync_read(IDS, TELEMETRY.address, TELEMETRY.length)) == 6


def test_with_wire_time_replies_and_silence_are_waited_for_as_on_a_serial_port(emulator):
    started_s = emulator.clock()
    emulator.port.writePort(packet(1, PING))
    assert len(emulator.port.receive(1.0)) == 6
    assert emulator.clock() - started_s == pytest.approx(12 * 10e-6 + 20e-6)
    started_s = emulator.clock()
    assert emulator.port.receive(0.25) == b""
    assert emulator.clock() - started_s == pytest.approx(0.25)
    started_s = emulator.clock()
    with pytest.raises(NoReply):
        emulator.open_bus().ping(9, attempts=1)
    assert LOCAL_LATENCY_S < emulator.clock() - started_s < 0.01


def test_unexpected_bytes_are_counted_and_a_frozen_adapter_keeps_no_more_than_a_pseudo_terminal(at_once):
    ping = packet(1, PING)
    at_once.port.writePort(ping)
    at_once.port.clearPort()
    assert at_once.port.discarded_bytes == 6
    assert at_once.port.receive(0.0) == b""
    at_once.port.writePort(ping)
    at_once.port.closePort()
    assert at_once.port.receive(0.0) == b""
    at_once.command(frozen=True)
    for _ in range(MAX_WAITING_BYTES):
        assert at_once.port.writePort(ping) == len(ping)
    assert at_once.port.receive(1.0) == b""
    at_once.command(frozen=False)
    assert len(at_once.port.receive(1.0)) == MAX_WAITING_BYTES // len(ping) * len(ping)
