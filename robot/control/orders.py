"""What each order does to the arm, as a sequence of steps that ends with a sentence or a RobotError."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from robot.control import torque
from robot.control.arm_on_bus import ArmOnBus
from robot.control.driver import Driver
from robot.control.guards import STALE_AFTER_S, Guards, Temperatures
from robot.control.startup import ServoFound, read_control, survey
from robot.control.steps import Steps
from robot.control.torque import TickLimits
from robot.control.upkeep import Upkeep
from robot.errors import NoReply, OrderRefused, StartupError
from robot.faults import Fault, FaultCode
from robot.limits import JointBounds
from robot.messages import ArmConfig, EmergencyPolicy, MotionEnded
from robot.servos.registers import StatusBit, status_names

# Between two looks at what ticks bring along: readings, and the end of motions that brake.
LOOK_AGAIN_S = 0.01
LOOKS = 200

# A fault cannot be reset while a servo complains of one of these; of its supply it may, which has a fault of its own.
GRAVE_STATUS = StatusBit.TEMPERATURE | StatusBit.OVERLOAD | StatusBit.CURRENT | StatusBit.ENCODER

Report = Callable[[list[MotionEnded]], None]


class Orders:
    """The orders to one arm on one bus.

    Args:
        arm: the arm.
        config: how it is to behave.
        bounds: soft limits before the servos' own are known.
        fault: one that was latched before this bus was opened.
        report: takes the motions that an order ends.
    """

    def __init__(
        self, arm: ArmOnBus, config: ArmConfig, bounds: JointBounds, fault: Fault | None, report: Report
    ) -> None:
        self._arm = arm
        self._config = config
        self._bounds = bounds
        self._early_fault = fault
        self._report = report
        self._temperatures = Temperatures(
            config.warn_temperature_c, config.slow_temperature_c, config.stop_temperature_c
        )

    @property
    def fault(self) -> Fault | None:
        """The latched fault."""
        return self._early_fault if self._arm.driver is None else self._arm.driver.fault

    def connect(self, *, may_enable: bool) -> Steps[str]:
        """Find the servos, adopt those that hold, and switch the arm on if it may be.

        Args:
            may_enable: whether an arm that is relaxed may be made to hold.
        """
        arm, servos = self._arm, self._arm.servos
        found = yield from survey(arm.bus, servos)
        yield from self._await_readings()
        driver = self._begin(found)
        holding = [servo for servo in servos.ids if found[servo].control.torque_on]
        wanted = list(servos.ids) if may_enable else holding
        if not wanted:
            return "the arm is relaxed"
        try:
            yield from self._enable(wanted)
        except (StartupError, NoReply) as error:
            self._refuse_start(driver, found, holding, str(error))
            raise
        if len(wanted) < len(servos.ids):
            limp = ", ".join(servos.label(servo) for servo in servos.ids if servo not in wanted)
            self._latch(FaultCode.TORQUE_LOST, f"the arm was found holding, but relaxed at {limp}")
        return "the arm was holding" if wanted == holding else "the arm holds"

    def _await_readings(self) -> Steps[None]:
        for _ in range(LOOKS):
            if self._arm.watch.complete:
                return
            yield LOOK_AGAIN_S
        raise StartupError("not every servo can be read")

    def _begin(self, found: dict[int, ServoFound]) -> Driver:
        servos = self._arm.servos
        own_limits = {servo: each.angle_limits_ticks for servo, each in found.items()}
        bounds = self._bounds.within_servos(self._config.calibration, own_limits)
        max_voltage_v = np.array([found[i].max_voltage_v for i in servos.ids])
        guards = Guards(servos.names, self._temperatures, max_voltage_v, self._config.guard_limits)
        full_torque = servos.full_torque / 1000.0
        driver = Driver(servos.names, bounds, guards, full_torque, self._temperatures, self._early_fault)
        self._arm.begin(driver, Upkeep(servos, found), TickLimits(servos.ticks_range(bounds), own_limits))
        return driver

    def _refuse_start(self, driver: Driver, found: dict[int, ServoFound], holding: list[int], reason: str) -> None:
        watch = self._arm.watch
        if holding:
            self._arm.hold(
                {
                    servo: each.control.goal_ticks if each.control.torque_on else watch.reading(servo).position_ticks
                    for servo, each in found.items()
                }
            )
        if driver.fault is None:
            self._latch(FaultCode.STARTUP_REFUSED, reason)

    def _enable(self, ids: Sequence[int]) -> Steps[None]:
        """Bring servos to hold."""
        arm = self._arm
        with self._telling():
            arm.hold((yield from torque.enable(arm.bus, arm.servos, arm.limits, ids)))

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        """Tell servos goals from here, while no tick tells them those that they had before."""
        self._arm.telling = False
        try:
            yield
        finally:
            self._arm.telling = True

    def enable(self) -> Steps[str]:
        """Make a relaxed arm hold where it is."""
        driver = self._ready_driver()
        if driver.driven:
            return "the arm is enabled already"
        try:
            yield from self._enable(self._arm.servos.ids)
        except (StartupError, NoReply) as error:
            self._latch(FaultCode.STARTUP_REFUSED, str(error))
            raise
        return "the arm holds"

    def relax(self) -> Steps[str]:
        """Stop, and take torque off so slowly that the arm sinks instead of falling; also in a fault."""
        driver = self._driver()
        driver.stop()
        for _ in range(LOOKS):
            if not driver.moving:
                break
            yield LOOK_AGAIN_S
        arm = self._arm
        if driver.driven:
            driver.release()
            left = yield from torque.relax(arm.bus, arm.servos, arm.torque_permille(driver))
        else:
            left = yield from torque.switch_off(arm.bus, list(arm.servos.ids))
        self._check_all_off(left, FaultCode.SERVO_SILENT)
        return "the arm is relaxed"

    def emergency_stop(self) -> Steps[str]:
        """Stop at once, by the configured policy; the first step sends the first broadcast."""
        driver = self._arm.driver
        if self._config.on_emergency_stop is EmergencyPolicy.HOLD and (driver is None or driver.driven):
            self._latch(FaultCode.EMERGENCY_STOP, "emergency stop: the arm holds where it is")
            return "the arm holds where it is"
        if driver is not None:
            driver.release()
        steps = torque.emergency_stop(self._arm.bus, self._arm.servos)
        first_wait_s = next(steps)
        self._latch(FaultCode.EMERGENCY_STOP, "emergency stop: torque is off")
        yield first_wait_s
        left = yield from steps
        self._check_all_off(left, FaultCode.EMERGENCY_STOP_UNVERIFIED)
        return "torque is off at every servo"

    def reset_fault(self) -> Steps[str]:
        """Clear the fault when its cause is gone."""
        driver = self._driver()
        fault = driver.fault
        if fault is None:
            return "there is no fault"
        arm, servos = self._arm, self._arm.servos
        self._check_answers()
        found = {}
        for servo in servos.ids:
            found[servo] = yield from read_control(arm.bus, servo)
        on = [servo for servo, control in found.items() if control.torque_on]
        yield from self._clear_overloads()
        yield LOOK_AGAIN_S
        self._check_causes(fault)
        if driver.driven and on:
            yield from self._enable(servos.ids)
        else:
            driver.release()
            self._check_all_off((yield from torque.switch_off(arm.bus, on)), fault.code)
        driver.reset()
        return "the arm holds" if driver.driven else "the arm is relaxed"

    def _clear_overloads(self) -> Steps[None]:
        """Try to clear latched overloads: torque off, and on again at the present position."""
        arm, driver = self._arm, self._driver()
        overloaded = [servo for servo in arm.servos.ids if arm.watch.status(servo) & StatusBit.OVERLOAD]
        with self._telling():
            for servo in overloaded:
                yield from torque.clear_overload(arm.bus, arm.servos, arm.limits, servo)
                if not driver.driven:
                    yield from torque.switch_off(arm.bus, [servo])
            if overloaded and driver.driven:
                goals = {}
                for servo in arm.servos.ids:
                    goals[servo] = (yield from read_control(arm.bus, servo)).goal_ticks
                arm.hold(goals)

    def _check_answers(self) -> None:
        now_s = time.monotonic()
        for servo in self._arm.servos.ids:
            if self._arm.watch.age_s(servo, now_s) > STALE_AFTER_S:
                raise OrderRefused(f"the servo of joint {self._arm.servos.label(servo)} does not answer")

    def _check_causes(self, fault: Fault) -> None:
        """Refuse to reset while a servo is hot or complains."""
        watch = self._arm.watch
        for servo in self._arm.servos.ids:
            label = self._arm.servos.label(servo)
            status = watch.status(servo) & GRAVE_STATUS
            if status:
                remedy = ": switch the servos' supply off and on" if status & StatusBit.OVERLOAD else ""
                raise OrderRefused(f"joint {label} still complains of {', '.join(status_names(status))}{remedy}")
            hot = fault.code is FaultCode.OVERHEATED
            limit_c = self._temperatures.warn_c if hot else self._temperatures.stop_c
            temperature_c = watch.reading(servo).temperature_c
            if temperature_c >= limit_c:
                raise OrderRefused(f"joint {label} is at {temperature_c} degC; it must be below {limit_c:g} degC")

    def _check_all_off(self, left: list[int], code: FaultCode) -> None:
        if left:
            names = ", ".join(self._arm.servos.label(servo) for servo in left)
            message = f"torque off could not be verified at {names}: they may still be driven"
            self._latch(code, message)
            raise OrderRefused(message)

    def _latch(self, code: FaultCode, message: str) -> None:
        fault = Fault(code, message, stamp_s=time.time())
        if self._arm.driver is None:
            self._early_fault = fault
        else:
            self._report(self._arm.driver.latch(fault))

    def _driver(self) -> Driver:
        if self._arm.driver is None:
            raise OrderRefused("the servos are still being checked")
        return self._arm.driver

    def _ready_driver(self) -> Driver:
        driver = self._driver()
        if driver.fault is not None:
            raise OrderRefused(f"the arm has a fault: {driver.fault}")
        return driver
