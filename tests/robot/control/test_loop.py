import contextlib
import socket
import time

import pytest

from robot.channel import Channel
from robot.control.loop import ArmLoop, hardware_opener
from robot.control.pacing import MAX_TICK_S, Pacer, Scheduling
from robot.errors import PortError
from robot.hardware.config import EmulatedConfig, IdealConfig, SerialConfig
from robot.messages import ArmConfig, Mode
from tests.helpers import dynamixel
from tests.helpers.arm_rig import CALIBRATION, NAMES, ROBOT
from tests.helpers.emulator import SteppedClock
from tests.helpers.programs import run_python


def test_simulated_hardware_opens_and_can_be_read_at_once() -> None:
    koch = ArmConfig(dynamixel.ROBOT, EmulatedConfig(dynamixel.CALIBRATION, kind="dynamixel"))
    for config in (ArmConfig(ROBOT, EmulatedConfig(CALIBRATION)), ArmConfig(ROBOT, IdealConfig()), koch):
        opened = hardware_opener(config, SteppedClock())()
        assert opened.joint_names == NAMES
        assert opened.read().position_rad == pytest.approx([0.0] * 6, abs=0.002), config


def test_a_port_that_is_not_there_is_an_error_only_when_it_is_opened() -> None:
    koch = ArmConfig(dynamixel.ROBOT, SerialConfig(dynamixel.CALIBRATION, "/dev/none", "dynamixel"))
    so101s = (ArmConfig(ROBOT, SerialConfig(CALIBRATION, port)) for port in ("/dev/none", "usb:0000:0001"))
    for config in (koch, *so101s):
        open_hardware = hardware_opener(config, SteppedClock())
        with pytest.raises(PortError, match=r"/dev/none|0000:0001"):
            open_hardware()


def test_sequences_go_on_when_every_tick_is_late() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        loop = ArmLoop(Channel(theirs), ArmConfig(ROBOT, EmulatedConfig(CALIBRATION)), Scheduling())
        supervisor = loop._supervisor
        supervisor.connect(loop._open())
        for tick in range(1000):
            late = Pacer(time.monotonic() - 1.0)
            loop._between_ticks(late)
            loop._clock.start_tick(time.monotonic() + tick * MAX_TICK_S)
            supervisor.tick(late, server_gone=False)
            ours.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                ours.recv(1 << 20)
            if supervisor.mode is Mode.HOLDING:
                break
        assert supervisor.mode is Mode.HOLDING


@pytest.mark.parametrize(
    ("hardware", "loaded"),
    [
        ("IdealConfig()", []),
        ("IdealConfig(physics=True)", ["mujoco"]),
        ("EmulatedConfig(Calibration.nominal(so101.hardware.servos))", ["scservo_sdk", "serial"]),
    ],
)
def test_each_kind_of_simulated_arm_loads_its_own_library_alone(hardware: str, loaded: list[str]) -> None:
    program = (
        "import sys; from robot.description.robot_folder import built_in; from robot.messages import ArmConfig; "
        "from robot.hardware.config import EmulatedConfig, IdealConfig; from robot.control.pacing import LoopClock; "
        "from robot.calibration import Calibration; from robot.control.loop import hardware_opener; "
        f"so101 = built_in('so101'); hardware_opener(ArmConfig(so101.model, {hardware}), LoopClock())(); "
        "print(sorted({'serial', 'scservo_sdk', 'dynamixel_sdk', 'mujoco'} & set(sys.modules)))"
    )
    assert run_python(program).stdout.strip() == str(loaded)
