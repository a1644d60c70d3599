"""Runs one arm: takes the server's messages, runs orders between the ticks, and minds that the server lives.

The loop calls :meth:`Supervisor.tick` 100 times a second, :meth:`Supervisor.work` in between, and hands every message
to :meth:`Supervisor.obey`. Buses come and go; a latched fault and the question whether the arm may be switched on
stay.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from robot.control import health
from robot.control.arm_on_bus import ArmOnBus
from robot.control.driver import RELAXING
from robot.control.orders import Orders
from robot.control.pacing import PERIOD_S, Pacer
from robot.control.steps import Steps
from robot.control.watchdog import Watchdog
from robot.errors import PortError, RobotError
from robot.faults import Fault, FaultCode
from robot.limits import JointBounds
from robot.messages import (
    ArmConfig,
    ArmHealth,
    ChangePace,
    Command,
    CommandDone,
    EndState,
    Execute,
    Mode,
    MotionEnded,
    Order,
    Outcome,
    Setpoint,
    Shutdown,
    Stop,
    Stream,
)
from robot.servos.bus import Bus
from robot.servos.servo_map import ServoMap

log = logging.getLogger("armbridge.arm")

# Between checks of an arm that was refused.
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 2.0

# Braking takes a second at most, relaxing 1.5 s, checking that torque is off up to a second where a servo does not
# answer, and all of it longer on a busy computer. Past it the process ends anyway, so that the server can keep its own
# deadline.
END_TIMEOUT_S = 5.0

HEALTH_PERIOD_TICKS = round(1.0 / PERIOD_S)

# What is in progress, as refusals and logs name it.
CONNECTING = "checking the servos"
RELAXING_ARM = "relaxing"
_NAMES = {
    Order.ENABLE: "enabling",
    Order.RELAX: RELAXING_ARM,
    Order.EMERGENCY_STOP: "emergency stop",
    Order.RESET_FAULT: "resetting the fault",
}

Send = Callable[[object, bool], None]


@dataclass
class _Task:
    """A sequence in progress; ``number`` is that of the command to answer, if a command asked for it."""

    name: str
    steps: Steps[str]
    number: int | None
    ready_s: float
    urgent: bool = False


class Supervisor:
    """One arm process's arm.

    Args:
        config: the arm.
        send: takes a message for the server, and whether it may be dropped while the server does not read.
        now_s: monotonic time [s].
        real_time: whether the process has real-time priority.

    Attributes:
        servos: the arm's servos.
        arm: the arm on its bus; None while there is no bus.
    """

    def __init__(self, config: ArmConfig, send: Send, now_s: float, *, real_time: bool) -> None:
        self._config = config
        self._send = send
        self._real_time = real_time
        names = tuple(joint.joint for joint in config.calibration.joints)
        self._bounds = JointBounds.of(config.robot, names)
        self.servos = ServoMap(config.calibration, self._bounds, config.guard_limits)
        self._ticks_per_state = max(1, round(1.0 / (PERIOD_S * config.state_rate_hz)))
        self._watchdog = Watchdog(config.watchdog_s, now_s)
        self.arm: ArmOnBus | None = None
        self._orders: Orders | None = None
        self._task: _Task | None = None
        self._fault: Fault | None = config.fault
        self._may_enable = config.start_enabled
        self._reason = ""
        self._retry_s = FIRST_RETRY_S
        self._check_at_s = now_s
        self._ticks = 0
        self._server_lost = False
        self._told_fault: Fault | None = None
        self._end: EndState | None = None
        self._end_begun_s: float | None = None

    @property
    def fault(self) -> Fault | None:
        """The latched fault."""
        return self._fault if self._orders is None else self._orders.fault

    @property
    def mode(self) -> Mode:
        """What the arm is doing."""
        if self.arm is None:
            return Mode.DISCONNECTED
        if self.fault is not None:
            return Mode.FAULT
        driver = self.arm.driver
        if driver is None or self._runs(CONNECTING):
            return Mode.CONNECTED
        return Mode.HOLDING if self._runs(RELAXING_ARM) and not driver.moving else driver.mode

    def connect(self, bus: Bus, now_s: float) -> None:
        """Begin with a bus that was opened."""
        self.arm = ArmOnBus(bus, self.servos)
        self._orders = Orders(self.arm, self._config, self._bounds, self._fault, self._report)
        self._check_at_s = now_s
        self._retry_s = FIRST_RETRY_S

    def disconnect(self, reason: str) -> None:
        """The bus is gone, or there is none: answer whatever was in progress."""
        if self.arm is not None and self.arm.driver is not None:
            lost = Fault(FaultCode.BUS_LOST, reason)
            self._report(self.arm.driver.abandon(Outcome.BUS_LOST, str(lost)))
        self._fault = self.fault
        self._interrupt(reason)
        self.arm = self._orders = None
        self._reason = reason
        self._send(health.disconnected(self.servos, reason, self._fault), True)

    def obey(self, message: object, now_s: float) -> None:
        """Take one message of the server.

        Raises:
            PortLost: the port is gone.
        """
        self._watchdog.hear(now_s)
        driver = self.arm.driver if self.arm is not None else None
        if isinstance(message, Execute | Stream):
            self._move(message)
        elif isinstance(message, Setpoint) and driver is not None:
            driver.steer(message)
        elif isinstance(message, Stop) and driver is not None:
            driver.stop(message.motion_id)
        elif isinstance(message, ChangePace) and driver is not None:
            driver.change_pace(message)
        elif isinstance(message, Command):
            self._command(message, now_s)
        elif isinstance(message, Shutdown):
            self._end = self._config.on_exit

    def tick(self, now_s: float, pacer: Pacer, *, server_gone: bool) -> None:
        """Run one cycle of the arm.

        Raises:
            PortLost: the port is gone.
        """
        arm = self.arm
        if arm is None:
            return
        self._report(arm.tick())
        for each in arm.driver.commanded if arm.driver is not None else ():
            self._send(each, True)
        self._mind_server(now_s, server_gone=server_gone)
        self._mind_fault(now_s)
        if arm.driver is None and self._task is None and now_s >= self._check_at_s and self._orders is not None:
            self._begin(_Task(CONNECTING, self._orders.connect(may_enable=self._may_enable), None, now_s))
        self._ticks += 1
        if self._ticks % self._ticks_per_state == 0:
            lateness_s = pacer.latest(self._ticks_per_state)
            self._send(health.arm_state(arm, self.mode, self.fault, self._reason, lateness_s), True)
        if self._ticks % HEALTH_PERIOD_TICKS == 0:
            self._send(self._health(arm, pacer), True)

    def work(self, now_s: float) -> float:
        """Do one step of the sequence in progress; returns how long there is nothing to do [s].

        Raises:
            PortError: the port is gone.
        """
        task = self._task
        if task is None:
            return float("inf")
        if now_s < task.ready_s:
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

    def finished(self, now_s: float) -> bool:
        """Whether the server is done with, and the arm in its end state."""
        if self._end is None:
            return False
        driver = self.arm.driver if self.arm is not None else None
        if driver is None:
            self._interrupt("the server is ending")
            return True
        self._end_begun_s = self._end_begun_s or now_s
        resting = not driver.moving and self._task is None and not (self._end is EndState.RELAX and driver.driven)
        return resting or now_s - self._end_begun_s > END_TIMEOUT_S

    def lose_server(self) -> None:
        """The server's process is gone: bring the arm to rest, then end."""
        if self._end is None:
            log.warning("the server is gone: stopping")
            self._end = self._config.on_server_lost

    def _move(self, command: Execute | Stream) -> None:
        refused, reason = Outcome.REFUSED, ""
        driver = self.arm.driver if self.arm is not None else None
        if self.arm is None:
            refused, reason = Outcome.BUS_LOST, f"the arm is not connected: {self._reason}"
        elif driver is None or (self._runs(CONNECTING) and driver.fault is None):
            reason = f"the servos are still being checked{self._reason and ': '}{self._reason}"
        elif self._end is not None or self._runs(RELAXING_ARM):
            reason = "the arm is being relaxed" if self._end is None else "the arm process is ending"
        else:
            ended = driver.execute(command) if isinstance(command, Execute) else driver.stream(command)
            self._report([ended] if ended is not None else [])
            return
        self._report([MotionEnded(command.motion_id, refused, reason)])

    def _command(self, command: Command, now_s: float) -> None:
        orders, order = self._orders, command.order
        urgent = order is Order.EMERGENCY_STOP
        if urgent:
            self._may_enable = False
        if orders is None:
            self._answer(command.number, f"the arm is not connected: {self._reason}", done=False)
            return
        busy = self._task
        if busy is not None and not urgent and (order is not Order.RELAX or busy.urgent):
            self._answer(command.number, f"the arm is busy: {busy.name}", done=False)
            return
        steps = {
            Order.ENABLE: orders.enable,
            Order.RELAX: orders.relax,
            Order.EMERGENCY_STOP: orders.emergency_stop,
            Order.RESET_FAULT: orders.reset_fault,
        }[order]()
        self._begin(_Task(_NAMES[order], steps, command.number, now_s, urgent))
        if urgent:
            self.work(now_s)

    def _begin(self, task: _Task) -> None:
        self._interrupt(f"given up for another order: {task.name}")
        self._task = task

    def _interrupt(self, reason: str) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.steps.close()
            self._answer(task.number, reason, done=False)

    def _finish(self, task: _Task, sentence: str, now_s: float, *, done: bool) -> None:
        self._task = None
        self._answer(task.number, sentence, done=done)
        log.log(logging.INFO if done else logging.WARNING, "%s: %s", task.name, sentence)
        if task.name != CONNECTING:
            return
        if self.arm is not None and self.arm.driver is not None:
            self._reason, self._may_enable = "", False
            return
        self._reason = sentence
        self._check_at_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, LONGEST_RETRY_S)

    def _runs(self, name: str) -> bool:
        return self._task is not None and self._task.name == name

    def _answer(self, number: int | None, sentence: str, *, done: bool) -> None:
        if number is not None:
            self._send(CommandDone(number, done, sentence), False)

    def _report(self, ended: list[MotionEnded]) -> None:
        for each in ended:
            self._send(each, False)

    def _mind_fault(self, now_s: float) -> None:
        """Tell of a new fault once, and take torque off where it asks for that."""
        fault = self.fault
        if fault is not self._told_fault:
            self._told_fault = fault
            if fault is not None:
                log.error("%s", fault)
        driver = self.arm.driver if self.arm is not None else None
        if fault is not None and fault.code in RELAXING and driver is not None and driver.driven:
            self._relax(now_s)

    def _mind_server(self, now_s: float, *, server_gone: bool) -> None:
        """Bring the arm to rest, and to its end state, when nobody drives it any more."""
        if server_gone:
            self.lose_server()
        lost = self._watchdog.barks(now_s)
        if lost and not self._server_lost:
            log.warning("nothing heard of the server for %.1f s: stopping", self._watchdog.silence_s(now_s))
        self._server_lost = lost
        end = self._config.on_server_lost if lost and self._end is None else self._end
        driver = self.arm.driver if self.arm is not None else None
        if end is None or driver is None:
            return
        driver.stop()
        if end is EndState.RELAX and driver.driven:
            self._relax(now_s)

    def _relax(self, now_s: float) -> None:
        """Relax the arm without an order, unless that or an emergency stop is in progress."""
        busy = self._task
        if self._orders is not None and (busy is None or not (busy.urgent or busy.name == RELAXING_ARM)):
            self._begin(_Task(RELAXING_ARM, self._orders.relax(), None, now_s))

    def _health(self, arm: ArmOnBus, pacer: Pacer) -> ArmHealth:
        return health.arm_health(
            arm, self.mode, self.fault, self._reason, self._config.port, pacer, real_time=self._real_time
        )
