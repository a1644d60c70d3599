"""Orders to the arm: sequences that return a sentence or raise a RobotError."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from robot.calibration import Calibration
from robot.control.controller import ArmController
from robot.control.cycle import ControlCycle
from robot.control.guards import ActuatorThresholds, Guards
from robot.errors import NoReply, OrderRefused, StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.interface import Measured, StatusFlag, Steps, Survey, status_names
from robot.messages import ArmConfig, EmergencyPolicy, MotionEnded

# Polling of conditions that only ticks change: first readings, and the end of motions that brake.
POLL_S = 0.01
POLLS = 200

# Status flags that keep a fault from being reset; the supply's flag does not, since it has a fault of its own.
GRAVE_STATUS = StatusFlag.TEMPERATURE | StatusFlag.OVERLOAD | StatusFlag.CURRENT | StatusFlag.ENCODER

# A servo is silent after this many missing replies at least: a network or a pseudo terminal delays one now and then.
SILENT_REPLIES = 10

Report = Callable[[list[MotionEnded]], None]


class Orders:
    """Orders to one arm on open hardware; the motions that they end are reported."""

    def __init__(self, arm: ControlCycle, config: ArmConfig, report: Report) -> None:
        self._arm = arm
        self._config = config
        self._report = report

    def connect(self, may_enable: Callable[[], bool]) -> Steps[str]:
        """Survey the actuators, take over the holding ones, and enable the arm where it then is permitted."""
        hardware = self._arm.hardware
        found = yield from hardware.survey()
        measured = yield from self._first_readings()
        controller = self._begin(found)
        joints = range(len(hardware.joint_names))
        holding = [joint for joint in joints if found.driven[joint]]
        wanted = list(joints) if may_enable() else holding
        if not wanted:
            return "the arm is relaxed"
        try:
            stopped = False
            with contextlib.closing(self._enable(wanted)) as enabling:
                for wait_s in enabling:
                    yield wait_s
                    if stopped := not (holding or may_enable()):
                        break
            if stopped:
                return (yield from self.relax())
        except (StartupError, NoReply) as error:
            if holding:
                self._arm.hold(np.where(found.driven, found.goal_rad, measured.position_rad))
            if controller.fault is None:
                self._latch(FaultCode.STARTUP_REFUSED, str(error))
            raise
        if len(wanted) < len(joints):
            limp = ", ".join(hardware.label(joint) for joint in joints if joint not in wanted)
            self._latch(FaultCode.TORQUE_LOST, f"the arm was found holding, but relaxed at {limp}")
        return "the arm was holding" if wanted == holding else "the arm holds"

    def _first_readings(self) -> Steps[Measured]:
        for _ in range(POLLS):
            if self._arm.measured is not None:
                return self._arm.measured
            yield POLL_S
        raise StartupError("not every servo can be read")

    def _begin(self, found: Survey) -> ArmController:
        hardware, config = self._arm.hardware, self._config
        silent_after_s = max(config.guard_limits.silent_after_s, SILENT_REPLIES * found.reply_latency_s)
        limits = replace(config.guard_limits, silent_after_s=silent_after_s)
        thresholds = ActuatorThresholds.of(limits, found.actuation, hardware.full_torque)
        guards = Guards(hardware.joint_names, found.max_voltage_v, limits, thresholds)
        controller = ArmController(
            hardware.joint_names,
            found.bounds,
            guards,
            hardware.full_torque,
            self._arm.fault,
            simulated=config.hardware.simulated,
            speed_limit=config.speed_limit,
        )
        self._arm.controller = controller
        return controller

    def _enable(self, joints: Sequence[int]) -> Steps[None]:
        with self._arm.writing_paused():
            self._arm.hold((yield from self._arm.hardware.enable(joints)))

    def enable(self) -> Steps[str]:
        """Enable a relaxed arm: it holds where it is."""
        controller = self._controller()
        if controller.fault is not None:
            raise OrderRefused(f"the arm has a fault: {controller.fault}")
        if controller.torque_enabled:
            return "the arm is enabled already"
        try:
            yield from self._enable(range(len(self._arm.hardware.joint_names)))
        except (StartupError, NoReply) as error:
            self._latch(FaultCode.STARTUP_REFUSED, str(error))
            raise
        return "the arm holds"

    def relax(self) -> Steps[str]:
        """Stop, then lower the torque so slowly that the arm sinks instead of falling; also in a fault."""
        controller, hardware = self._controller(), self._arm.hardware
        controller.stop()
        yield from self._until_rest(controller)
        if controller.torque_enabled:
            controller.release()
            left = yield from hardware.relax(controller.torque_limit)
        else:
            left = yield from hardware.switch_off()
        self._check_all_off(left, FaultCode.SERVO_SILENT)
        return "the arm is relaxed"

    def _until_rest(self, controller: ArmController) -> Steps[None]:
        for _ in range(POLLS):
            if not controller.moving:
                break
            yield POLL_S

    def emergency_stop(self) -> Steps[str]:
        """Stop at once by the configured policy; torque is cut with the first step."""
        controller = self._arm.controller
        if self._config.on_emergency_stop is EmergencyPolicy.HOLD and (controller is None or controller.torque_enabled):
            self._latch(FaultCode.EMERGENCY_STOP, "emergency stop: the arm holds where it is")
            return "the arm holds where it is"
        if controller is not None:
            controller.release()
        steps = self._arm.hardware.cut_torque()
        first_wait_s = next(steps)
        self._latch(FaultCode.EMERGENCY_STOP, "emergency stop: torque is off")
        yield first_wait_s
        left = yield from steps
        self._check_all_off(left, FaultCode.EMERGENCY_STOP_UNVERIFIED)
        return "torque is off at every servo"

    def reset_fault(self) -> Steps[str]:
        """Reset the fault when its cause is gone."""
        controller, hardware = self._controller(), self._arm.hardware
        fault = controller.fault
        if fault is None:
            return "there is no fault"
        yield from self._until_rest(controller)
        silent_after_s = controller.guards.limits.silent_after_s
        for joint, age_s in enumerate(self._readings().age_s.tolist()):
            if age_s > silent_after_s:
                raise OrderRefused(f"the servo of joint {hardware.label(joint)} does not answer")
        try:
            yield from self._remove_causes(controller, fault)
        except (GeneratorExit, StartupError, NoReply):
            # Also at a stop: joints that were enabled must not go to the goals of before.
            self._hold_still(controller)
            raise
        controller.reset()
        return "the arm holds" if controller.torque_enabled else "the arm is relaxed"

    def _remove_causes(self, controller: ArmController, fault: Fault) -> Steps[None]:
        hardware = self._arm.hardware
        driven = yield from hardware.driven()
        yield from self._clear_overloads(controller)
        yield POLL_S
        self._check_causes(fault)
        on = [joint for joint, flag in enumerate(driven.tolist()) if flag]
        if controller.torque_enabled and on:
            yield from self._enable(range(len(hardware.joint_names)))
        else:
            controller.release()
            self._check_all_off((yield from hardware.switch_off(on)), fault.code)

    def _hold_still(self, controller: ArmController) -> None:
        """Hold each joint that is far from its goal at its position."""
        measured = self._arm.measured
        if measured is None or not controller.torque_enabled:
            return
        away_rad = np.abs(measured.position_rad - controller.goal_rad)
        near = away_rad <= controller.guards.thresholds.goal_tolerance_rad
        if not near.all():
            self._arm.hold(np.where(near, controller.goal_rad, measured.position_rad))

    def write_calibration(self, calibration: Calibration | None) -> Steps[str]:
        """Write a calibration into the servos of a relaxed arm; its readings then differ from this process's."""
        if calibration is None:
            raise OrderRefused("there is no calibration to write")
        if self._controller().torque_enabled:
            raise OrderRefused("the arm holds, and a new homing offset would move its goals: relax it first")
        return (yield from self._arm.hardware.write_calibration(calibration))

    def survey(self) -> Steps[str]:
        """Survey the actuators of a relaxed arm again; the controller's limits stay as they are."""
        yield from self._arm.hardware.survey()
        return "the servos were checked after a calibration was written to them"

    def _clear_overloads(self, controller: ArmController) -> Steps[None]:
        status = self._readings().status.tolist()
        latched = self._arm.hardware.latched_status
        overloaded = [joint for joint, word in enumerate(status) if word & latched]
        if not overloaded:
            return
        with self._arm.writing_paused():
            goal_rad = yield from self._arm.hardware.clear_overloads(overloaded, hold=controller.torque_enabled)
            if goal_rad is not None:
                self._arm.hold(goal_rad)

    def _check_causes(self, fault: Fault) -> None:
        measured = self._readings()
        readings = zip(measured.status.tolist(), measured.temperature_c.tolist(), strict=True)
        limits = self._config.guard_limits
        limit_c = limits.warn_temperature_c if fault.code is FaultCode.OVERHEATED else limits.stop_temperature_c
        for joint, (word, temperature_c) in enumerate(readings):
            label, status = self._arm.hardware.label(joint), word & GRAVE_STATUS
            if status:
                cut = status & StatusFlag.OVERLOAD and not self._config.hardware.simulated
                remedy = ": switch the servos' supply off and on" if cut else ""
                raise OrderRefused(f"joint {label} still complains of {', '.join(status_names(status))}{remedy}")
            if temperature_c >= limit_c:
                raise OrderRefused(f"joint {label} is at {temperature_c:.0f} degC; it must be below {limit_c:g} degC")

    def _check_all_off(self, left: Sequence[str], code: FaultCode) -> None:
        if left:
            message = (
                f"torque off could not be verified at {', '.join(left)}: they may still be driven until the servos' "
                "supply is cut"
            )
            self._latch(code, message)
            raise OrderRefused(message)

    def _latch(self, code: FaultCode, message: str) -> None:
        fault = Fault(code, message, stamp_s=time.time(), simulated=self._config.hardware.simulated)
        self._report(self._arm.latch(fault))

    def _readings(self) -> Measured:
        if self._arm.measured is None:
            raise OrderRefused("the servos are still being checked")
        return self._arm.measured

    def _controller(self) -> ArmController:
        if self._arm.controller is None:
            raise OrderRefused("the servos are still being checked")
        return self._arm.controller
