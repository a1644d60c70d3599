"""An arm process without the process: the supervisor on emulated servos, driven tick by tick in a time of its own."""

from collections.abc import Callable
from typing import Any, Self, TypeVar

import numpy as np

from robot import messages
from robot.calibration import Calibration
from robot.control.guards import ActuatorThresholds, Guards
from robot.control.pacing import Pacer, Scheduling
from robot.control.supervisor import Supervisor
from robot.description.limits import JointBounds, within_calibration
from robot.hardware.config import EmulatedConfig, IdealConfig, SerialConfig
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import Feetech
from robot.hardware.feetech.registers import Register
from robot.hardware.ideal import IdealArm
from robot.hardware.interface import Actuation, HardwareInterface, Measured, Steps, Survey, run_to_end
from robot.hardware.servos.hardware import ServoHardware
from robot.trajectory import PERIOD_S, Trajectory
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.robots import nominal_calibration, so101


def reading(position_rad: Any, **told: Any) -> Measured:
    """Return a measurement of six servos; every named value is one number for all joints, or six."""
    usual = {
        "velocity_rad_s": 0.0,
        "load": 0.0,
        "current_a": 0.0,
        "voltage_v": 6.0,
        "temperature_c": 35.0,
        "status": 0,
        "age_s": 0.0,
    }
    columns = {name: np.broadcast_to(np.asarray(value), (6,)) for name, value in (usual | told).items()}
    return Measured(position_rad=np.asarray(position_rad, dtype=float), **columns)


NO_LIMIT = np.full(6, np.inf)

# Strength of servos without settings.
PLAIN = Actuation.unprotected(np.full(6, 5.5), np.full(6, 0.46))


def guards(
    limits: messages.GuardLimits | None = None,
    max_voltage_v: Any = NO_LIMIT,
    thresholds: ActuatorThresholds | None = None,
) -> Guards:
    limits = limits or messages.GuardLimits()
    thresholds = thresholds or ActuatorThresholds.of(limits, PLAIN, np.ones(6))
    return Guards(NAMES, max_voltage_v, limits, thresholds)


Result = TypeVar("Result")


def run(steps: Steps[Result]) -> Result:
    """Take every step at once, without the waits in between; returns what the sequence returns."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            result: Result = done.value
            return result


CALIBRATION = nominal_calibration()
ROBOT = within_calibration(so101(), CALIBRATION)
NAMES = tuple(joint.joint for joint in CALIBRATION.joints)
BOUNDS = JointBounds.of(ROBOT, NAMES)

# A simulated arm's configuration, and that of one on metal, whose rules are stricter.
CONFIG = messages.ArmConfig(ROBOT, EmulatedConfig(CALIBRATION))
METAL = SerialConfig(CALIBRATION, "/dev/arm")

# A transaction takes 1 to 2 ms, and the tick's own a third of its period.
STEPS_A_TICK = 4


def unread_hardware(
    emulator: Any,
    config: SerialConfig | EmulatedConfig = METAL,
    limits: messages.GuardLimits | None = None,
    *,
    family: Callable[[], Any] = Feetech,
    bounds: JointBounds = BOUNDS,
) -> ServoHardware:
    """Hardware that was neither found nor read."""
    opened, limits, simulated = emulator.open_bus(), limits or messages.GuardLimits(), config.simulated
    return ServoHardware(family(), opened, config.calibration, bounds, limits, emulator.clock, simulated=simulated)


class ServosInUse:
    """Hardware on emulated servos, found and read once."""

    def __init__(self, emulator: Any, hardware: ServoHardware) -> None:
        self.emulator = emulator
        self.hardware = hardware
        self.found: Survey = run_to_end(hardware.survey())
        self.read()

    def read(self, after_s: float = 0.01) -> Measured:
        self.emulator.run(after_s)
        measured = self.hardware.read()
        assert measured is not None
        return measured

    def enable(self) -> np.ndarray:
        """Bring all joints to hold; returns their goals."""
        return run_to_end(self.hardware.enable(range(6)), self.emulator.run)


class FeetechsInUse(ServosInUse):
    def __init__(self, emulator: SteppedEmulator | None = None) -> None:
        emulator = emulator or SteppedEmulator()
        super().__init__(emulator, unread_hardware(emulator))


class ArmRig:
    """A supervisor on emulated servos, which it takes for real ones unless ``hardware`` says otherwise.

    With an ideal arm for ``hardware`` it drives that, and the servos are only there.
    """

    _unread = staticmethod(unread_hardware)

    def __init__(self, emulator: SteppedEmulator | None = None, **settings: Any) -> None:
        self.emulator = emulator or SteppedEmulator(wire_time=False)
        self.clock = self.emulator.clock
        self.sent: list[object] = []
        self.alive = True
        self.config = messages.ArmConfig(**{"robot": ROBOT, "hardware": METAL, **settings})
        self.supervisor = Supervisor(
            self.config, lambda message, **_: self.sent.append(message), self.clock, Scheduling()
        )
        self.bus: Bus = self.emulator.open_bus()
        self.pacer = Pacer(self.clock())
        self._numbers = 0
        self.observed = True
        self.connect()

    def started(self) -> Self:
        """Wait until the arm holds, or is relaxed where it is not to be enabled; returns this."""
        self.until_mode(messages.Mode.HOLDING if self.config.start_enabled else messages.Mode.RELAXED)
        return self

    def connect(self) -> None:
        """Open the hardware, again if it was open."""
        self.bus = self.emulator.open_bus()
        self.supervisor.connect(self._hardware())

    def _hardware(self) -> HardwareInterface:
        config = self.config
        if isinstance(config.hardware, IdealConfig):
            return IdealArm(config.hardware, NAMES, BOUNDS, self.clock)
        assert isinstance(config.hardware, SerialConfig | EmulatedConfig)
        return self._unread(self.emulator, config=config.hardware, limits=config.guard_limits)

    @property
    def mode(self) -> messages.Mode:
        return self.supervisor.mode

    @property
    def fault_code(self) -> str:
        return "" if self.supervisor.fault is None else self.supervisor.fault.code.value

    @property
    def state(self) -> messages.ArmState:
        return next(message for message in reversed(self.sent) if isinstance(message, messages.ArmState))

    @property
    def health(self) -> messages.ArmHealth:
        return next(message for message in reversed(self.sent) if isinstance(message, messages.ArmHealth))

    @property
    def ended(self) -> list[messages.MotionEnded]:
        return [message for message in self.sent if isinstance(message, messages.MotionEnded)]

    @property
    def outcomes(self) -> list[messages.Outcome]:
        """How the motions ended."""
        return [ended.outcome for ended in self.ended]

    def tick(self) -> None:
        """One period of the loop."""
        for _ in range(STEPS_A_TICK):
            if self.supervisor.work() > 0.0:
                break
        self.clock.advance(PERIOD_S)
        self.pacer.start_tick(self.clock())
        if self.alive:
            self.supervisor.handle(messages.Heartbeat(self.observed))
        self.supervisor.tick(self.pacer, server_gone=False)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.tick()

    def until(self, condition: Callable[[], bool], timeout_s: float = 6.0) -> None:
        until_s = self.clock() + timeout_s
        while not condition():
            assert self.clock() < until_s, f"timed out in {self.mode}, {self.supervisor.fault}"
            self.tick()

    def until_mode(self, mode: messages.Mode) -> None:
        self.until(lambda: self.mode is mode)

    def begin(self, order: messages.Order, calibration: Calibration | None = None) -> int:
        """Give an order; returns its number."""
        self._numbers += 1
        self.supervisor.handle(messages.Command(self._numbers, order, calibration))
        return self._numbers

    def answer(self, number: int) -> messages.CommandDone | None:
        answers = [each for each in self.sent if isinstance(each, messages.CommandDone) and each.number == number]
        assert len(answers) <= 1, "an order was answered twice"
        return answers[0] if answers else None

    def order(self, order: messages.Order, calibration: Calibration | None = None) -> messages.CommandDone:
        """Give an order and wait for its answer."""
        return self.wait(self.begin(order, calibration))

    def wait(self, number: int) -> messages.CommandDone:
        """Wait for the answer to an order that was begun."""
        self.until(lambda: self.answer(number) is not None)
        answer = self.answer(number)
        assert answer is not None
        return answer

    def refused(self, order: messages.Order, calibration: Calibration | None = None) -> str:
        """Give an order that is refused; returns the reason."""
        answer = self.order(order, calibration)
        assert not answer.done, answer.message
        return answer.message

    def execute(self, trajectory: Trajectory, motion_id: int = 1, **options: Any) -> None:
        self.supervisor.handle(messages.Execute(motion_id, trajectory, **options))

    def torque(self) -> list[int]:
        """Register TORQUE_ENABLE of every servo."""
        return [self.bus.read(joint.servo_id, Register.TORQUE_ENABLE) for joint in CALIBRATION.joints]
