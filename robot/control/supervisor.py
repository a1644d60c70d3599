"""Supervisor of one arm: handles messages, runs orders between the ticks, watches the server, and reports."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from robot.control.controller import RELAXING, ArmController
from robot.control.cycle import ControlCycle, arm_health, arm_state
from robot.control.orders import Orders
from robot.control.pacing import LoopClock, Pacer, Scheduling
from robot.control.parking import Parking, Stage
from robot.errors import PortError, RobotError
from robot.faults import Fault, FaultCode
from robot.hardware.interface import HardwareInterface, Steps, run_to_end
from robot.logs import LogLimiter
from robot.messages import (
    END_LIMIT_S,
    END_TIMEOUT_S,
    PARKING_TIMEOUT_S,
    RELAXING_ARM,
    TORQUE_LEFT_ON,
    ArmConfig,
    ArmState,
    ChangePace,
    Command,
    CommandDone,
    EndState,
    Execute,
    Heartbeat,
    KeepParking,
    Mode,
    MotionEnded,
    Order,
    Outcome,
    PauseSimulation,
    Setpoint,
    Shutdown,
    Stop,
    Stream,
)
from robot.physics.bodies import SetBodies
from robot.stop_epochs import STOPPED_SINCE
from robot.trajectory import PERIOD_S

log = logging.getLogger("armbridge.arm")

MAX_STATES_PER_S = 200.0  # of the machine's time, which a server takes beside its other work

# Interval between attempts to open the hardware, and to check the servos: the first, and the longest.
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 2.0

# A silent server may come back within this time: the arm only brakes until then, and parks afterwards.
SILENCE_BEFORE_PARKING_S = 5.0

# A standstill of the arm process or the server for so long stops an arm at rest, too: people have come near, and do not
# expect that a motion from before it begins. No starved machine was seen to stand still for so long.
STANDSTILL_S = 5.0

HEALTH_PERIOD_TICKS = round(1.0 / PERIOD_S)

# A simulated arm at rest skips every other tick, and four of five (20 a second are left) while nobody sees its states.
SPARE_TICKS = 1
IDLE_SPARE_TICKS = 4

SETTLED_TICKS = round(0.5 / PERIOD_S)  # ticks at rest after which the joints have reached the end of their last motion
SIMULATED_WATCHDOG_S = 5.0  # least watchdog timeout of a simulated arm, which a server on a busy machine must not trip

# Log lines about a silent server: at once, and in the long run [1/s], one in ten minutes.
SILENCE_BURST = 3
SILENCE_LINES_PER_S = 1.0 / 600.0

# Names of sequences in progress, in refusals and logs.
CONNECTING = "checking the servos"
CHECKING_AGAIN = "checking the servos again"
SWITCHING_OFF = "relaxing after a stop"
_NAMES = {
    Order.ENABLE: "enabling",
    Order.RELAX: RELAXING_ARM,
    Order.EMERGENCY_STOP: "emergency stop",
    Order.RESET_FAULT: "resetting the fault",
    Order.WRITE_CALIBRATION: "writing the calibration",
}


class Send(Protocol):
    """Function that sends a message to the server."""

    def __call__(self, message: object, *, droppable: bool = False) -> None:
        """Send a message; a droppable one is left out while the server does not read."""


class Supervisor:
    """Supervisor of one arm."""

    def __init__(self, config: ArmConfig, send: Send, clock: LoopClock, scheduling: Scheduling) -> None:
        self._config = config
        self._send = send
        self._clock = clock
        self._scheduling = scheduling
        self._joint_names = config.hardware.joint_names(config.robot)
        # Of a clock that is faster than the machine's; the server is silent in the machine's time.
        self._rate = config.hardware.rate
        least_ticks = round(self._rate / (PERIOD_S * MAX_STATES_PER_S))
        self._ticks_per_state = max(1, round(1.0 / (PERIOD_S * config.state_rate_hz)), least_ticks)
        least_s = SIMULATED_WATCHDOG_S if config.hardware.simulated else 0.0
        self._watchdog_s = max(config.watchdog_s, least_s) * self._rate
        self._heard_s = clock()
        self._log_limiter = LogLimiter(SILENCE_BURST, SILENCE_LINES_PER_S)
        self.arm: ControlCycle | None = None  # on the open hardware; None while disconnected
        self._orders: Orders | None = None
        self._task: _Task | None = None
        self._fault: Fault | None = config.fault  # latched before the hardware was opened, or lost
        self._may_enable = config.start_enabled and not config.stopped
        self._last_stop = config.last_stop
        self._stopped = config.stopped  # ArmState.stopped
        self._halted = ""  # ArmState.halted
        self._reason = ""
        self._retry_s = FIRST_RETRY_S
        self._check_at_s = clock()
        self._state_due, self._health_due = self._ticks_per_state, HEALTH_PERIOD_TICKS
        self._observed = True
        self._rested_ticks = 0
        self._server_lost = False
        self._reported_fault: Fault | None = None
        self._end: EndState | None = None
        self._end_epoch = 0  # stop epoch in which it was requested
        self._end_begun_s: float | None = None
        self._end_ticks = 0
        self._ended = False
        self._lost_driven = False  # True when torque was on as the hardware was lost
        self._parking = Parking(self._joint_names)
        self._bodies: SetBodies | None = None  # bodies around an arm with physics, kept while it is disconnected

    @property
    def fault(self) -> Fault | None:
        return self._fault if self.arm is None else self.arm.fault

    @property
    def _controller(self) -> ArmController | None:
        return None if self.arm is None else self.arm.controller

    @property
    def mode(self) -> Mode:
        """State of the arm's state machine."""
        if self.arm is None:
            return Mode.DISCONNECTED
        if self.fault is not None:
            return Mode.FAULT
        controller = self.arm.controller
        if controller is None or self._runs(CONNECTING):
            return Mode.CONNECTED
        return Mode.HOLDING if self._runs(RELAXING_ARM) and not controller.moving else controller.mode

    def connect(self, hardware: HardwareInterface) -> None:
        """Begin to control hardware that was opened."""
        self.arm = ControlCycle(hardware, self._clock, self._fault)
        self._orders = Orders(self.arm, self._config, self._report)
        self._check_at_s = self._clock()
        self._retry_s = FIRST_RETRY_S
        self._set_bodies()

    def _set_bodies(self) -> None:
        world = None if self.arm is None else self.arm.hardware.world
        if world is not None and self._bodies is not None:
            world.set_bodies(self._bodies)

    def disconnect(self, reason: str) -> None:
        """End motions and orders in progress: the hardware is gone, or could not be opened."""
        if self._controller is not None:
            self._lost_driven = self._controller.torque_enabled
            lost = Fault(FaultCode.BUS_LOST, reason, simulated=self._config.hardware.simulated)
            self._report(self._controller.abandon(Outcome.BUS_LOST, str(lost)))
        self._fault = self.fault
        self._interrupt(reason)
        self.arm = self._orders = None
        self._reason = reason
        # The servos are checked again, which takes time.
        self._clock.pause(paused=False)
        stamp_s, lost_s, fault, names = self._clock.stamp_s(time.time()), self._clock(), self._fault, self._joint_names
        state = ArmState(stamp_s, Mode.DISCONNECTED, names, reason=reason, fault=fault, clock_s=lost_s)
        self._send(self._with_stop(state), droppable=True)

    def _with_stop(self, state: ArmState) -> ArmState:
        return replace(state, halted=self._halted, last_stop=self._last_stop, stopped=self._stopped)

    def handle(self, message: object) -> None:
        self._heard_s = self._clock()
        controller = self._controller
        match message:
            case Execute() | Stream():
                self._move(message)
            case Setpoint() if controller is not None:
                controller.steer(message)
            case Stop():
                if message.epoch > self._last_stop:
                    self._take_stop(message.epoch)
                if controller is not None:
                    controller.stop(message.motion_id)
            case ChangePace() if controller is not None:
                controller.change_pace(message)
                # Hardware that is lost and comes back keeps the limit.
                self._config = replace(self._config, speed_limit=controller.pace.speed_limit)
            case Command():
                self._command(message)
            case Heartbeat():
                self._observed = message.observed
            case Shutdown():
                self._end, self._end_epoch = self._config.on_exit, message.epoch
                if message.hurry and self._end is EndState.PARK and controller is not None:
                    self._parking.give_up(controller, "the server must not wait")
            case KeepParking():
                self._parking.keep(message.plan)
            case SetBodies():
                self._bodies = message
                self._set_bodies()
            case PauseSimulation():
                self._clock.pause(paused=message.paused, ticks=message.ticks)

    def _take_stop(self, epoch: int) -> None:
        """Take a stop of all motion: no earlier request moves the arm, or switches its torque on."""
        self._last_stop, self._stopped, self._halted = epoch, True, ""
        self._may_enable = False
        # An arm that was enabled already holds.
        relaxed = self._controller is not None and not self._controller.torque_enabled
        if self._orders is not None and relaxed and self._runs(_NAMES[Order.ENABLE]):
            self._begin(_Task(SWITCHING_OFF, self._orders.relax(), None, self._clock()))
        elif self._runs(_NAMES[Order.RESET_FAULT]):
            self._interrupt("given up: a stop came")

    @property
    def spare_ticks(self) -> int:
        """Number of ticks that may be skipped now: of a simulated arm at rest, whose machine has other work."""
        controller = self._controller
        if not self._config.hardware.simulated or controller is None or self._task or not controller.resting:
            return 0
        if not self._observed and self._rested_ticks >= SETTLED_TICKS and self._config.hardware.stays_at_rest:
            return IDLE_SPARE_TICKS
        return SPARE_TICKS if self._ticks_per_state > SPARE_TICKS else 0

    def tick(self, pacer: Pacer, *, server_gone: bool, ticks: int = 1) -> None:
        """Run one cycle of the arm, ``ticks`` periods after the last one."""
        arm, now_s = self.arm, self._clock()
        if arm is None:
            return
        if self._end is not None:
            self._end_ticks += ticks
            self._clock.pause(paused=False)
        if self._halts_after(pacer.late_s, "the arm process stood still for {:.1f} s") and arm.controller:
            arm.controller.stop()
        ended = arm.tick()
        self._clock.follow_real_time(steered=arm.controller is not None and bool(arm.controller.commanded))
        self._parking.take(ended)
        self._report(ended)
        for each in arm.controller.commanded if arm.controller is not None else ():
            self._send(each, droppable=True)
        self._check_server(now_s, server_gone=server_gone)
        self._check_fault()
        self._check_servos(now_s)
        resting = arm.controller is not None and arm.controller.resting
        self._rested_ticks = self._rested_ticks + ticks if resting else 0
        self._state_due -= ticks
        self._health_due -= ticks
        if min(self._state_due, self._health_due) > 0:
            return
        lateness_s = pacer.latest(self._ticks_per_state)
        task = RELAXING_ARM if self._runs(RELAXING_ARM) else ""
        reason = "it is being relaxed" if task else self._reason
        state = arm_state(arm, self.mode, reason, lateness_s, self._clock)
        state = self._with_stop(replace(state, task=task, tick_s=pacer.tick_s))
        if self._state_due <= 0:
            # States that skipped ticks left out are not made up for.
            self._state_due = max(self._state_due + self._ticks_per_state, 1)
            if (world := arm.hardware.world) is not None:
                # A state may be dropped on its way: once a second all bodies are in it.
                bodies = world.moved_bodies(every=self._health_due <= 0)
                state = replace(state, bodies=bodies, stepped_ticks=self._clock.stepped_ticks)
            self._send(state, droppable=True)
        if self._health_due <= 0:
            self._health_due += HEALTH_PERIOD_TICKS
            port = self._config.hardware.port
            health = arm_health(arm, state, port, pacer, self._clock, self._scheduling)
            self._send(health, droppable=True)

    def work(self) -> float:
        """Do one step of the sequence in progress; return the time until the next [s], infinite without one."""
        task, now_s = self._task, self._clock()
        if task is None:
            return float("inf")
        # An emergency stop does not wait for a time that stands still.
        if now_s < task.ready_s and not (task.urgent and self._clock.stepped_ticks is not None):
            return task.ready_s - now_s
        try:
            task.ready_s = now_s + next(task.steps)
        except StopIteration as done:
            self._finish(task, str(done.value), now_s, done=True)
        except PortError:
            raise
        except RobotError as error:
            self._finish(task, str(error), now_s, done=False)
        return 0.0

    def finished(self) -> bool:
        """Return True when the process may end: the server ends, and the arm is in its end state or had its time."""
        self._ended = self._ended or self._reaches_end()
        return self._ended

    def _reaches_end(self) -> bool:
        if self._end is None:
            return False
        controller, now_s = self._controller, self._clock()
        self._end_begun_s = self._end_begun_s or now_s
        taken_s = now_s - self._end_begun_s
        if controller is None:
            # Servos that are still being checked may hold, as a process before this one has left them.
            unfinished = (self._lost_driven or self.arm is not None) and self._end is not EndState.HOLD
        else:
            driven = self._end is not EndState.HOLD and controller.torque_enabled
            unfinished = controller.moving or self._task is not None or driven
        timeout_s = END_TIMEOUT_S + (PARKING_TIMEOUT_S if self._end is EndState.PARK else 0.0)
        in_time = self._end_ticks * PERIOD_S <= timeout_s and taken_s <= END_LIMIT_S
        if unfinished and in_time and self.arm is not None:
            return False
        self._interrupt("the server is ending")
        if unfinished:
            log.error(
                "the arm is not in its end state (%s) after %.0f s, in which it had %d ticks; the process ends: %s",
                self._end.value,
                taken_s,
                self._end_ticks,
                self._torque_left(),
            )
        return True

    def _check_servos(self, now_s: float) -> None:
        orders = self._orders
        if orders is None or self._task is not None or now_s < self._check_at_s:
            return
        if self._controller is None:
            steps = orders.connect(lambda: self._may_enable and self._end is None)
            self._begin(_Task(CONNECTING, steps, None, now_s))
        elif self.arm is not None and self.arm.hardware.needs_survey and self._end is None:
            self._begin(_Task(CHECKING_AGAIN, orders.survey(), None, now_s))

    def _torque_left(self) -> str:
        where = f"torque may be on at every joint: the arm is not connected: {self._reason}"
        if self.arm is not None:
            hardware = self.arm.hardware
            try:
                driven = run_to_end(hardware.driven(), lambda _wait_s: None)
            except RobotError as error:
                where = f"torque may be on at every joint: {error}"
            else:
                labels = [hardware.label(joint) for joint in np.flatnonzero(driven).tolist()]
                if not labels:
                    return "torque is off at every joint"
                where = f"torque is on at {', '.join(labels)}"
        return where if self._config.hardware.simulated else f"{where}. {TORQUE_LEFT_ON}"

    def lose_server(self) -> None:
        """Begin to bring the arm to its end state: the server's process is gone."""
        if self._end is None:
            end = self._end_when_lost
            log.warning("the server is gone: %s", self._consequence(end))
            self._end, self._end_epoch = end, self._last_stop

    @property
    def _end_when_lost(self) -> EndState:
        """End state of an arm whose server is lost: nobody sees an arm move to its rest pose that somebody stopped."""
        end = self._config.on_server_lost
        return EndState.HOLD if self._stopped and end is EndState.PARK else end

    def _halts_after(self, standstill_s: float, sentence: str) -> bool:
        """Take a standstill for a stop; return True if it is one.

        A motion may go on after a standstill within the watchdog's timeout, and begin after one within STANDSTILL_S.
        Parking goes on after the latter, too: a stop would have the arm relaxed on its way.
        """
        controller, limit_s = self._controller, self._watchdog_s / self._rate
        if controller is None or not controller.moving or self._parking.stage is not Stage.NOT_BEGUN:
            limit_s = max(limit_s, STANDSTILL_S)
        if controller is None or standstill_s <= limit_s:
            return False
        if not self._halted:
            self._halted, self._state_due = sentence.format(standstill_s), 0
        return True

    def _move(self, command: Execute | Stream) -> None:
        refused, reason = Outcome.REFUSED, ""
        controller = self._controller
        if command.epoch < self._last_stop:
            refused, reason = Outcome.STOPPED, STOPPED_SINCE
        elif self._halted:
            refused, reason = Outcome.STOPPED, self._halted
        elif self.arm is None:
            refused, reason = Outcome.BUS_LOST, f"the arm is not connected: {self._reason}"
        elif controller is None or (self._runs(CONNECTING) and controller.fault is None):
            reason = f"the servos are still being checked{self._reason and ': '}{self._reason}"
        elif self._end is not None or self._runs(RELAXING_ARM):
            reason = "the arm is being relaxed" if self._end is None else "the arm process is ending"
        else:
            ended = controller.execute(command) if isinstance(command, Execute) else controller.stream(command)
            self._stopped = self._stopped and ended is not None and ended.outcome is Outcome.REFUSED
            self._report([ended] if ended is not None else [])
            return
        self._report([MotionEnded(command.motion_id, refused, reason)])

    def _command(self, command: Command) -> None:
        orders, order, now_s = self._orders, command.order, self._clock()
        urgent = order is Order.EMERGENCY_STOP
        if urgent:
            self._may_enable = False
            self._last_stop, self._stopped = max(self._last_stop, command.epoch), True
        if order in (Order.ENABLE, Order.RESET_FAULT) and command.epoch < self._last_stop:
            self._answer(command.number, f"{_NAMES[order]}: a stop came after it was requested", done=False)
            return
        if orders is None:
            self._answer(command.number, f"the arm is not connected: {self._reason}", done=False)
            return
        busy = self._task
        # Begun again, relaxing would cut the torque that is being lowered.
        if busy is not None and not urgent and (order is not Order.RELAX or busy.urgent or busy.name == RELAXING_ARM):
            self._answer(command.number, f"the arm is busy: {busy.name}", done=False)
            return
        starts: dict[Order, Callable[[], Steps[str]]] = {
            Order.ENABLE: orders.enable,
            Order.RELAX: orders.relax,
            Order.EMERGENCY_STOP: orders.emergency_stop,
            Order.RESET_FAULT: orders.reset_fault,
            Order.WRITE_CALIBRATION: lambda: orders.write_calibration(command.calibration),
        }
        self._stopped = urgent
        steps = starts[order]()
        self._begin(_Task(_NAMES[order], steps, command.number, now_s, urgent))

    def _begin(self, task: _Task) -> None:
        """Begin a sequence and give up the present one; an urgent sequence begins before the present one tidies up."""
        given_up, self._task = self._task, task
        try:
            if task.urgent:
                self.work()
        finally:
            self._give_up(given_up, f"given up for another order: {task.name}")

    def _interrupt(self, reason: str) -> None:
        given_up, self._task = self._task, None
        self._give_up(given_up, reason)

    def _give_up(self, task: _Task | None, reason: str) -> None:
        if task is not None:
            task.steps.close()
            self._answer(task.number, reason, done=False)

    def _finish(self, task: _Task, sentence: str, now_s: float, *, done: bool) -> None:
        self._task = None
        self._answer(task.number, sentence, done=done)
        if done and task.name == CONNECTING and self._config.hardware.simulated:
            log.info("the simulated arm is ready")
        else:
            log.log(logging.INFO if done else logging.WARNING, "%s: %s", task.name, sentence)
        if task.name not in (CONNECTING, CHECKING_AGAIN):
            return
        if task.name == CONNECTING and self._controller is not None:
            self._reason, self._may_enable = "", False
            return
        if task.name == CONNECTING:
            self._reason = sentence
        self._check_at_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, LONGEST_RETRY_S)

    def _runs(self, name: str) -> bool:
        return self._task is not None and self._task.name == name

    def _answer(self, number: int | None, sentence: str, *, done: bool) -> None:
        if number is not None:
            self._send(CommandDone(number, done, sentence))

    def _report(self, ended: list[MotionEnded]) -> None:
        for each in ended:
            self._send(each)
        if ended:
            # The server reports the end with the state that shows it.
            self._state_due = 0

    def _check_fault(self) -> None:
        fault = self.fault
        if fault is not self._reported_fault:
            self._reported_fault = fault
            if fault is not None:
                log.error("%s", fault)
        controller = self._controller
        if fault is not None and fault.code in RELAXING and controller is not None and controller.torque_enabled:
            self._relax()

    def _check_server(self, now_s: float, *, server_gone: bool) -> None:
        """Watch the server; stop the arm, and bring it to its end state, when the server is lost or ending."""
        if server_gone:
            self.lose_server()
        silent_s = (now_s - self._heard_s) / self._rate
        lost = now_s - self._heard_s > self._watchdog_s
        end = self._end
        if self._end is None:
            if lost:
                end = self._end_when_lost
                if not self._server_lost:
                    line = f"nothing heard of the server for {silent_s:.1f} s: {self._consequence(end)}"
                    self._log_limiter.write(log, logging.WARNING, line, "silence", now_s)
            self._halts_after(silent_s, "nothing was heard of the server for {:.1f} s")
        self._server_lost = lost
        if self._controller is not None:
            gone = self._end is not None or silent_s > SILENCE_BEFORE_PARKING_S
            self._bring_to_end(self._controller, end, now_s, gone=gone)

    def _bring_to_end(self, controller: ArmController, end: EndState | None, now_s: float, *, gone: bool) -> None:
        """Take the next step to an end state; None if the server is there, so that parking is given up."""
        if self._parking.stage is not Stage.NOT_BEGUN and end is not EndState.PARK:
            self._parking.reset(controller)
        if end is None:
            return
        if end is EndState.PARK:
            if self._end is not None and self._end_epoch < self._last_stop:
                self._parking.give_up(controller, STOPPED_SINCE)
            self._parking.advance(controller, now_s, may_move=gone)
        else:
            controller.stop()
        if controller.torque_enabled and (end is EndState.RELAX or self._parking.stage is Stage.OVER):
            self._relax()

    def _consequence(self, end: EndState) -> str:
        controller = self._controller
        if controller is not None and controller.moving:
            return "stopping"
        if controller is not None and controller.torque_enabled and end is not EndState.HOLD:
            return "relaxing" if end is EndState.RELAX else "parking"
        return "nothing moves"

    def _relax(self) -> None:
        busy = self._task
        if self._orders is not None and (busy is None or not (busy.urgent or busy.name == RELAXING_ARM)):
            self._begin(_Task(RELAXING_ARM, self._orders.relax(), None, self._clock()))


@dataclass
class _Task:
    name: str
    steps: Steps[str]
    number: int | None  # of the command to answer; None for a sequence that no command began
    ready_s: float  # time of its next step [s]
    urgent: bool = False  # True for an emergency stop, which nothing interrupts
