from __future__ import annotations

import json
import re

import pytest

from robot.calibration import Calibration
from robot.emulator import control
from robot.emulator.adapter import UsbAdapter
from robot.emulator.arm import build_servos
from robot.emulator.control import FOR_SERVOS, NUMBERS, SWITCHES, VALUES, Emulation, answer
from robot.emulator.faults import PROBABILITIES, Faults
from robot.emulator.servo_bus import ServoBus
from robot.emulator.write_log import WriteLog
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.interface import StatusFlag


@pytest.fixture
def log_path(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def emulation(log_path):
    log, adapter = WriteLog(log_path), UsbAdapter()
    yield Emulation(ServoBus(build_servos(Calibration.nominal(), [0.0] * 6), Faults(), 0.0, log), adapter)
    adapter.unplug()
    log.close()


def test_every_command_is_carried_out_and_acknowledged(emulation):
    faults = emulation.bus.faults
    assert json.loads(answer(b'{"drop": 0.25, "corrupt": 1, "offline": [3, 4]}', emulation)) == {"ok": True}
    assert (faults.drop, faults.corrupt, faults.offline) == (0.25, 1.0, {3, 4})
    assert json.loads(answer(b'{"online": [3]}', emulation)) == {"ok": True}
    assert faults.offline == {4}


def test_values_go_to_the_servos_named(emulation):
    assert json.loads(answer(b'{"push": {"2": 50, "3": -7}}', emulation)) == {"ok": True}
    assert [servo.plant.push_permille for servo in emulation.bus.servos] == [0, 50, -7, 0, 0, 0]


def test_null_ends_what_can_be_ended(emulation):
    plant = emulation.bus.servos[0].plant
    answer(b'{"hand": {"1": 2000}}', emulation)
    assert plant.hand_ticks == 2000
    answer(b'{"hand": {"1": null}}', emulation)
    assert plant.hand_ticks is None


def test_an_adapter_comes_and_goes_and_its_name_is_reported(emulation):
    before = emulation.adapter.port
    assert json.loads(answer(b'{"plugged": false}', emulation)) == {"ok": True, "port": before}
    assert emulation.adapter.descriptors == []
    reply = json.loads(answer(b'{"plugged": "renamed"}', emulation))
    assert reply == {"ok": True, "port": emulation.adapter.port}
    assert reply["port"] != before
    assert len(emulation.adapter.descriptors) == 1


def test_a_switch_goes_on_and_off(emulation):
    answer(b'{"frozen": true}', emulation)
    assert emulation.adapter.frozen
    answer(b'{"frozen": false}', emulation)
    assert not emulation.adapter.frozen


def test_a_command_is_put_on_record(emulation, log_path):
    answer(b'{"push": {"2": 50}}', emulation)
    answer(b'{"push": {"9": 50}}', emulation)
    (line,) = map(json.loads, log_path.read_text().splitlines())
    assert line["command"] == {"push": {"2": 50}}


@pytest.mark.parametrize("name", [*NUMBERS, *FOR_SERVOS, *VALUES, *SWITCHES, "plugged"])
def test_every_command_is_documented(name):
    assert f'``{{"{name}": ' in str(control.__doc__)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{", "Expecting"),
        (b"\xff", "decode"),
        (b"[]", "JSON object"),
        (b'{"explode": 1}', "unknown command 'explode'"),
        (b'{"drop": 1.5}', "drop is a probability from 0 to 1, not 1.5"),
        (b'{"corrupt": NaN}', "probability"),
        (b'{"corrupt": "x"}', "probability"),
        (b'{"noise": true}', "probability"),
        (b'{"delay_s": 1' + b"0" * 400 + b"}", "delay_s is a number from 0 to 10"),
        (b'{"supply": -1}', "supply is a number from 0 to 25.5, not -1"),
        (b'{"offline": [7]}', r"out of \[1, 2, 3, 4, 5, 6\]"),
        (b'{"offline": 3}', "list of servo ids"),
        (b'{"online": [[]]}', "list of servo ids"),
        (b'{"hand": [3]}', "object with servo ids"),
        (b'{"hand": {"7": 2000}}', "object with servo ids"),
        (b'{"hand": {"1": 5000}}', "hand is a number from 0 to 4095, not 5000"),
        (b'{"push": {"1": null}}', "push is a number"),
        (b'{"frozen": 1}', "frozen is true or false"),
        (b'{"plugged": "elsewhere"}', "plugged is true, false or 'renamed'"),
    ],
)
def test_what_makes_no_sense_is_answered_with_the_reason(emulation, line, reason):
    reply = answer(line, emulation)
    assert reply.endswith(b"\n")
    assert re.search(reason, json.loads(reply)["error"])


def test_no_part_of_a_refused_command_is_carried_out(emulation):
    assert "error" in json.loads(answer(b'{"drop": 0.5, "offline": [9]}', emulation))
    assert emulation.bus.faults.drop == 0.0


@pytest.fixture
def servo(emulation):
    servo = emulation.bus.servos[2]
    servo.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, 2048))
    servo.write(Register.TORQUE_ENABLE, bytes([1]))
    return servo


def run(servo, duration_s):
    for _ in range(round(duration_s / 0.01)):
        servo.step(0.01)


@pytest.mark.parametrize("name", PROBABILITIES)
def test_every_probability_is_one_of_the_faults(emulation, name):
    NUMBERS[name].put(emulation, 0.5)
    assert getattr(emulation.bus.faults, name) == 0.5


def test_numbers_go_where_they_belong(emulation):
    for name, value in {"delay_s": 0.1, "supply": 4.5, "heat_rate": 7.0, "usb_frame_ms": 1.0}.items():
        NUMBERS[name].put(emulation, value)
    assert emulation.bus.faults.delay_s == 0.1
    assert emulation.adapter.frame_s == 0.001
    assert {(servo.voltage_v, servo.motor.rate) for servo in emulation.bus.servos} == {(4.5, 7.0)}


def test_a_servo_goes_off_the_bus_and_comes_back(emulation, servo):
    FOR_SERVOS["offline"](emulation, servo)
    assert emulation.bus.faults.offline == {3}
    FOR_SERVOS["online"](emulation, servo)
    assert emulation.bus.faults.offline == set()


def test_a_power_cycle_switches_torque_off_and_forgets_the_goal(emulation, servo):
    FOR_SERVOS["power_cycle"](emulation, servo)
    assert servo.value(Register.TORQUE_ENABLE) == servo.value(Register.GOAL_POSITION) == 0


def test_torque_goes_off_behind_the_drivers_back_and_the_goal_stays(emulation, servo):
    FOR_SERVOS["torque_off"](emulation, servo)
    assert (servo.value(Register.TORQUE_ENABLE), servo.value(Register.GOAL_POSITION)) == (0, 2048)


def test_a_servo_can_be_made_to_power_up_holding(emulation, servo):
    FOR_SERVOS["powers_up_holding"](emulation, servo)
    FOR_SERVOS["power_cycle"](emulation, servo)
    assert (servo.value(Register.TORQUE_ENABLE), servo.value(Register.GOAL_POSITION)) == (1, servo.present_ticks)


def test_an_overload_can_be_made_to_last_until_a_power_cycle(emulation, servo):
    FOR_SERVOS["overload_latches"](emulation, servo)
    VALUES["obstacle"].put(servo, 2060)
    servo.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, 2600))
    run(servo, 2.5)
    FOR_SERVOS["torque_off"](emulation, servo)
    run(servo, 0.1)
    assert servo.error == StatusFlag.OVERLOAD
    FOR_SERVOS["power_cycle"](emulation, servo)
    assert servo.error == 0


def test_an_obstacle_stands_at_a_tick_of_the_present_position(servo):
    servo.write(Register.HOMING_OFFSET, encode(Register.HOMING_OFFSET, -40))
    VALUES["obstacle"].put(servo, 2100)
    servo.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, 2400))
    run(servo, 1.0)
    assert servo.present_ticks == 2100
    VALUES["obstacle"].end(servo)
    run(servo, 1.0)
    assert servo.present_ticks == 2400


def test_a_hand_takes_the_joint_to_a_tick_of_the_present_position(servo):
    servo.write(Register.HOMING_OFFSET, encode(Register.HOMING_OFFSET, 40))
    VALUES["hand"].put(servo, 1900)
    run(servo, 0.5)
    assert servo.present_ticks == 1900
    VALUES["hand"].end(servo)
    run(servo, 0.5)
    assert servo.present_ticks == 2048


def test_the_rest_reaches_the_servo(servo):
    before = servo.present_ticks
    for name, value in {"push": 100.0, "jump": 400.0, "temperature": 66.0, "voltage": 4.2, "status": 2.0}.items():
        VALUES[name].put(servo, value)
    assert servo.plant.push_permille == 100.0
    assert servo.present_ticks == before + 400
    assert (servo.motor.temperature_c, servo.voltage_v) == (66.0, 4.2)
    run(servo, 0.02)
    assert servo.error == StatusFlag.ENCODER


def test_switches_reach_bus_and_adapter(emulation):
    for switch in SWITCHES.values():
        switch(emulation, True)
    assert emulation.bus.faults.stall_behind_missing
    assert emulation.adapter.frozen
