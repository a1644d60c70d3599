"""Handle on the arm process: the server's side of motions, streams and orders.

Time limits of motions and orders count on the arm's own clock, reported with its states, so that a simulated arm on a
busy machine has all its time. A process that sends no state for :data:`SILENT_S` is killed and restarted.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

from robot.calibration import Calibration
from robot.hardware.config import ClockReading
from robot.logs import LogLimiter
from robot.messages import (
    END_LIMIT_S,
    STARTING_ARM,
    TORQUE_LEFT_ON,
    ArmConfig,
    ArmHealth,
    ArmState,
    ChangePace,
    Command,
    CommandDone,
    Commanded,
    Continuation,
    EndState,
    Execute,
    Heartbeat,
    KeepParking,
    Mode,
    MotionEnded,
    MotionProgress,
    Order,
    Outcome,
    ParkingPlan,
    PauseSimulation,
    Setpoint,
    Shutdown,
    Stop,
    Stream,
)
from robot.physics.bodies import SetBodies
from robot.processes import ENDED_IN_ORDER, Child, DescriptorReserve, RestartDelay, StartedChild
from robot.stop_epochs import STOP_EPOCHS, STOPPED_SINCE
from robot.trajectory import Trajectory, Vector

log = logging.getLogger("armbridge.arm")

Ending = TypeVar("Ending", MotionEnded, CommandDone)

NO_MOTION = 0  # motions are numbered from 1 on; 0 is a motion of the arm process itself

STATE_POLL_S = 0.02

HEARTBEAT_S = 0.1  # a fifth of the shortest watchdog timeout of the arm process

# Silence after which a process hangs, however busy the machine is; states come at least once a second. Counted in
# heartbeats, because a server that was stopped itself hears nothing either.
SILENT_S = 5.0
SILENT_HEARTBEATS = round(SILENT_S / HEARTBEAT_S)

# A real arm whose states are this old is stuck; a simulated one may be starved, and is waited for.
STATE_MAX_AGE_S = 1.0

# Relaxing takes longest: braking 2 s at most, the ramp 1.5 s, checking that torque is off some tenths.
ORDER_TIMEOUT_S = 6.0

# Log lines on processes that end or cannot be started: the first, then one in ten minutes [1/s].
RESTART_LINES = 10
RESTART_LINES_PER_S = 1.0 / 600.0

# By the arm's clock, longer than the arm process takes to brake, park, relax and end.
CLOSE_TIMEOUT_S = END_LIMIT_S + 1.0

# Silence after which a process that ends holding is not waited for: the arm is at rest, and holds without its process.
SILENT_HOLDING_S = 0.8

# Longest end by the machine's clock: a simulated arm on a busy machine may need three seconds for each of its own.
CLOSE_LIMIT_S = 60.0


def start_arm_process(name: str = "") -> StartedChild:
    """Start an arm process, which loads its modules; its log lines have the arm's name, or none for a lone arm."""
    return StartedChild("robot.control.loop", name)


class Splice(NamedTuple):
    """Motion that another one continues without a stop."""

    motion: asyncio.Future[MotionEnded]
    from_s: float  # time on it at which the other one begins [s]
    leaves_s: float  # monotonic time until which both coincide [s]


class ArmClock(ABC):
    """Clock of an arm, on which waits for it count."""

    @property
    @abstractmethod
    def state_age_s(self) -> float:
        """Age of the latest state [s]."""

    @property
    @abstractmethod
    def clock_s(self) -> float:
        """Clock of the arm's control loop, from the latest state [s]."""

    async def wait(self, ends: Collection[asyncio.Future[Any]], timeout_s: float) -> bool:
        """Wait until all of some futures are done, for a time on the arm's clock; return True when they are."""
        until_s = self.clock_s + timeout_s
        while (pending := [end for end in ends if not end.done()]) and self.clock_s < until_s:
            if self.state_age_s > SILENT_S:
                break
            # On an arm's clock that is faster than the machine's this waits too long, which is harmless. The first wait
            # lasts all of the time, so that states that come late to a server that stood still cut nothing short.
            await asyncio.wait(pending, timeout=max(until_s - self.clock_s, HEARTBEAT_S))
        return all(end.done() for end in ends)


class Arm(ArmClock):
    """Arm driven by the arm process, which is restarted when it dies; motions and orders in progress then end.

    States and health are passed on in the event loop. ``observed`` returns False when nobody sees the states.
    """

    def __init__(
        self,
        config: ArmConfig,
        on_state: Callable[[ArmState], None],
        on_health: Callable[[ArmHealth], None] = lambda _health: None,
        started: StartedChild | None = None,
        restart_delay: RestartDelay | None = None,
        observed: Callable[[], bool] = lambda: True,
        name: str = "",
    ) -> None:
        self._config = config
        self.name = name
        self._observed = observed
        self._on_state = on_state
        self._on_health = on_health
        self._process = ArmProcess(self._received, self._exited, started, name)
        self._motions: dict[int, asyncio.Future[MotionEnded]] = {}
        self._streams: dict[int, ArmStream] = {}
        self._orders: dict[int, asyncio.Future[CommandDone]] = {}
        self._emergency: int | None = None  # latest emergency stop, until a process answers it
        self._timeouts: set[asyncio.Task[None]] = set()
        self._held: list[MotionEnded | CommandDone] = []
        self._ids = itertools.count(1)
        self._closing = False
        self._restart: asyncio.Task[None] | None = None
        self._restart_delay = restart_delay or RestartDelay()
        self._restart_log = LogLimiter(RESTART_LINES, RESTART_LINES_PER_S)
        self._heartbeat: asyncio.Task[None] | None = None
        self._first_state = asyncio.Event()
        self._starting = False
        self._begun = False
        # Monotonic time of the running process's first state: its life counts from there, and so does its silence.
        self._heard_since_s: float | None = None
        self._silent_heartbeats = 0
        self._state_at_s = time.monotonic()
        # Stop epoch of the last stop of all motion, at first of its start; requests from earlier epochs move nothing.
        self.last_stop = STOP_EPOCHS.begin()
        self._speed_factor = 1.0
        self._bodies: SetBodies | None = None
        reason = "the arm process is starting"
        state = ArmState(time.time(), Mode.DISCONNECTED, (), reason=reason, task=STARTING_ARM, clock_s=time.monotonic())
        self.state = self._with_speed_limit(replace(state, last_stop=self.last_stop))
        # Age above which the latest state counts as stale [s].
        self.state_max_age_s = SILENT_S if config.hardware.simulated else STATE_MAX_AGE_S
        # Simulated joints of a restarted process continue from here.
        self._last_connected = self.state

    async def launch(self) -> None:
        """Start the process; it opens no hardware before :meth:`start`, and takes no orders."""
        self._starting = True
        await self._process.launch()

    async def start(self, timeout_s: float) -> None:
        """Configure the process, and wait for the arm's first state, connected or not; else raise TimeoutError."""
        if self._process.pid is None:
            await self.launch()
        self._begun = True
        self._configure()
        self._heartbeat = asyncio.create_task(self._beat(), name="heartbeat of the arm process")
        try:
            await asyncio.wait_for(self._first_state.wait(), timeout_s)
        finally:
            self._starting = False

    def _configure(self) -> None:
        self._process.configure(replace(self._config, last_stop=self.last_stop, stopped=self._stopped))
        if self._bodies is not None:
            self._process.send(self._bodies)
        if self._emergency is not None and self._emergency not in self._orders:
            # There was no process with a configuration, or it ended before it answered.
            self.order(Order.EMERGENCY_STOP)

    @property
    def _stopped(self) -> bool:
        """True from a stop, also while no process runs or before it reports the stop, until more is asked."""
        return self.state.stopped or self.state.last_stop < self.last_stop

    def simulate(self, command: SetBodies | PauseSimulation) -> None:
        """Command the world of an arm with physics; a restarted process has the same bodies, and no pause."""
        if isinstance(command, SetBodies):
            self._bodies = command
        self._process.send(command)

    async def until_started(self, timeout_s: float) -> None:
        """Wait while :meth:`start` is in progress, for ``timeout_s`` at most; return at once when it is not."""
        if self._starting:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._first_state.wait(), timeout_s)

    @property
    def pid(self) -> int | None:
        return self._process.pid

    @property
    def pids(self) -> tuple[int, ...]:
        return () if self.pid is None else (self.pid,)

    def part(self, _joint_names: Collection[str]) -> Arm:
        """Return the arm that has some joints, which is this one: see :class:`robot.arm_group.ArmGroup`."""
        return self

    @property
    def rate(self) -> float:
        """Time by the arm's clock per time of the machine, where the machine is fast enough."""
        return self._config.hardware.rate

    @property
    def state_age_s(self) -> float:
        return time.monotonic() - self._state_at_s

    @property
    def clock_s(self) -> float:
        return self.state.clock_s

    def execute(
        self,
        trajectory: Trajectory,
        *,
        gripping: bool = False,
        torque_share: float = 1.0,
        continues: Splice | None = None,
        epoch: int | None = None,
    ) -> asyncio.Future[MotionEnded]:
        """Send a trajectory at once and in order with :meth:`stop`; the future of its end never raises.

        A motion may take the place of another one without a stop. It has the stop epoch in which it was requested, None
        for now; see :class:`robot.messages.Execute` for the rest.
        """
        motion_id = next(self._ids)
        continuation = None
        if continues is not None:
            continuation = Continuation(self._number(continues.motion), continues.from_s, continues.leaves_s)
        epoch = _epoch_of_request(epoch)
        return self._begin(Execute(motion_id, trajectory, gripping, torque_share, continuation, epoch))

    def progress(self, motion: asyncio.Future[MotionEnded]) -> MotionProgress | None:
        """Return the progress of a motion by the latest state; None before the arm has begun it, and after its end."""
        number = self._number(motion)
        return next((motion for motion in self.state.motions if motion.motion_id == number), None)

    def stream(self, joint_names: tuple[str, ...], epoch: int | None = None, *, gripping: bool = False) -> ArmStream:
        """Begin a stream of velocity setpoints, at rest until the first; with ``gripping`` a stall ends it well."""
        motion_id = next(self._ids)
        ended = self._begin(Stream(motion_id, joint_names, _epoch_of_request(epoch), gripping))
        stream = ArmStream(motion_id, joint_names, ended, self._process.send)
        self._streams[motion_id] = stream
        ended.add_done_callback(lambda _: self._streams.pop(motion_id, None))
        return stream

    async def end_streams(self, timeout_s: float) -> bool:
        """Bring every stream to rest; return True when all have ended within ``timeout_s``."""
        ends = [stream.ended for stream in self._streams.values()]
        for ended in ends:
            self.stop(ended)
        return await self.wait(ends, timeout_s)

    def stop(self, motion: asyncio.Future[MotionEnded] | None = None) -> None:
        """Brake one motion in progress along its path; all of them for None."""
        if motion is None:
            self.last_stop = STOP_EPOCHS.begin()
            self._process.send(Stop(epoch=self.last_stop))
        elif (number := self._number(motion)) != NO_MOTION:
            self._process.send(Stop(number))

    def brake(self) -> None:
        """Brake every motion in progress; this is no stop, which ends requests too."""
        self._process.send(Stop())

    def change_pace(self, change: ChangePace) -> None:
        if change.speed_factor is not None:
            self._speed_factor = change.speed_factor
        self._process.send(change)
        if change.speed_limit is not None:
            self._config = replace(self._config, speed_limit=change.speed_limit)
            self.state = self._with_speed_limit(self.state)
            if self.state.mode is Mode.DISCONNECTED:
                # No state follows by itself.
                self._on_state(self.state)

    async def rest(self, timeout_s: float) -> bool:
        """Wait until every motion in progress has ended; return True when they have within ``timeout_s``."""
        until_s = self.clock_s + timeout_s
        ended = await self.wait(list(self._motions.values()), timeout_s)
        # The arm process's own way to the rest pose is in the states alone.
        while ended and any(each.motion_id == NO_MOTION for each in self.state.motions):
            ended = self.clock_s < until_s and self.state_age_s < SILENT_S
            await asyncio.sleep(STATE_POLL_S)
        return ended

    def order(
        self, order: Order, calibration: Calibration | None = None, epoch: int | None = None
    ) -> asyncio.Future[CommandDone]:
        """Send an order to the arm before returning; its future is resolved in time and never raises.

        WRITE_CALIBRATION needs a calibration. The epoch is the stop epoch in which the order was requested, None for
        now: after a later stop the arm is not enabled. Its time counts on the arm's clock. An emergency stop that no
        process answers is made by the next one.
        """
        number = next(self._ids)
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[CommandDone] = loop.create_future()
        if order is Order.EMERGENCY_STOP:
            epoch = self.last_stop = STOP_EPOCHS.begin()
            self._emergency = number
        if not self._process.configured:
            later = "; the emergency stop is made as soon as it runs" if order is Order.EMERGENCY_STOP else ""
            answered.set_result(CommandDone(number, done=False, message=f"the arm process is not running{later}"))
            return answered
        self._process.send(Command(number, order, calibration, _epoch_of_request(epoch)))
        self._orders[number] = answered
        answered.add_done_callback(lambda _: self._orders.pop(number, None))
        timeout = asyncio.create_task(self._time_out(number, answered), name="timeout of an order to the arm")
        self._timeouts.add(timeout)
        timeout.add_done_callback(self._timeouts.discard)
        return answered

    async def _time_out(self, number: int, answered: asyncio.Future[CommandDone]) -> None:
        if not await self.wait((answered,), ORDER_TIMEOUT_S):
            message = f"the arm process did not answer in {ORDER_TIMEOUT_S:g} s"
            _settle(answered, CommandDone(number, done=False, message=message))

    def keep_parking(self, plan: ParkingPlan | None) -> None:
        """Give the process the way to the rest pose that it plays at its end; None when there is no way."""
        self._process.send(KeepParking(plan))

    async def close(self, epoch: int | None = None) -> None:
        """Bring the arm to its end state and end the process; after a stop that is later than the epoch, do not park.

        That takes :data:`CLOSE_TIMEOUT_S` at most on the arm's clock, and :data:`CLOSE_LIMIT_S` on the machine's. A
        caller that cancels this leaves a process that hurries, and ends by itself.
        """
        self._closing = True
        if self._restart is not None:
            self._restart.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._restart
        try:
            ended = self._process.ended
            if ended is not None and self._process.configured:
                self._process.send(Shutdown(_epoch_of_request(epoch)))
                await self._wait_for_end(ended)
                if ended.done():
                    await self._process.leave()
            # The last state does not show it: the process may have hung, or been killed, while it relaxed.
            if self._begun and (ending := self._process.ending) != ENDED_IN_ORDER:
                advice = "" if self._config.hardware.simulated else f". {TORQUE_LEFT_ON}"
                log.warning(
                    "the arm process has not ended in order (%s); torque may be on at every joint%s", ending, advice
                )
            await self._process.kill()
        except asyncio.CancelledError:
            self._process.send(Shutdown(hurry=True))
            log.warning("the arm process (%s) is not waited for: it ends by itself", self.pid)
            raise
        finally:
            if self._heartbeat is not None:
                self._heartbeat.cancel()
            self._process.close()

    async def _wait_for_end(self, ended: asyncio.Future[None]) -> None:
        """Wait for the end of the process: as long as it may take by its clock, and while it sends states."""
        silent_s = SILENT_HOLDING_S if self._config.on_exit is EndState.HOLD else SILENT_S
        until_s, limit_s = self.clock_s + CLOSE_TIMEOUT_S, time.monotonic() + CLOSE_LIMIT_S
        heard_s, waits = self._state_at_s, 0
        # Silence is counted in waits, as in heartbeats.
        while waits * HEARTBEAT_S < silent_s and self.clock_s < until_s and time.monotonic() < limit_s:
            await asyncio.wait((ended,), timeout=HEARTBEAT_S)
            if ended.done():
                return
            waits = waits + 1 if self._state_at_s == heard_s else 0
            heard_s = self._state_at_s

    async def _beat(self) -> None:
        while True:
            await asyncio.sleep(HEARTBEAT_S)
            self._process.send(Heartbeat(self._observed()))
            self._silent_heartbeats += self._heard_since_s is not None
            if self._silent_heartbeats > SILENT_HEARTBEATS:
                log.error("the arm process has been silent for %g s and is ended", SILENT_S)
                await self._process.kill()

    def _begin(self, command: Execute | Stream) -> asyncio.Future[MotionEnded]:
        ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
        motion_id = command.motion_id
        if command.epoch < self.last_stop:
            ended.set_result(MotionEnded(motion_id, Outcome.STOPPED, STOPPED_SINCE))
            return ended
        if not self._process.configured:
            ended.set_result(MotionEnded(motion_id, Outcome.PROCESS_LOST, "the arm process is not running"))
            return ended
        self._motions[motion_id] = ended
        ended.add_done_callback(lambda _: self._motions.pop(motion_id, None))
        # Sent each time: the arm process may have been restarted since the last motion.
        self._process.send(ChangePace(self._speed_factor, speed_limit=self._config.speed_limit))
        self._process.send(command)
        return ended

    def _number(self, motion: asyncio.Future[MotionEnded]) -> int:
        return next((number for number, each in self._motions.items() if each is motion), NO_MOTION)

    def _received(self, message: Any) -> None:
        # Ends are held back until the next state, which must show them: a fault, or that the arm holds again.
        match message:
            case ArmState():
                self._silent_heartbeats = 0
                if self._heard_since_s is None:
                    self._heard_since_s = time.monotonic()
                self._take_state(message)
            case ArmHealth():
                self._on_health(message)
            case Commanded():
                if message.motion_id in self._streams:
                    self._streams[message.motion_id].commanded = message
            case CommandDone():
                if message.number == self._emergency:
                    self._emergency = None
                if message.done:
                    self._held.append(message)
                else:
                    self._answer(message)
            # A refused motion changes nothing, and is sent again at once where it came too late.
            case MotionEnded() if message.outcome is Outcome.REFUSED or self.state.mode is Mode.DISCONNECTED:
                self._answer(message)
            case MotionEnded():
                self._held.append(message)

    def _answer(self, message: MotionEnded | CommandDone) -> None:
        if isinstance(message, MotionEnded):
            _settle(self._motions.get(message.motion_id), message)
        else:
            _settle(self._orders.get(message.number), message)

    def _answer_held(self) -> None:
        held, self._held = self._held, []
        for message in held:
            self._answer(message)

    def _with_speed_limit(self, state: ArmState) -> ArmState:
        """Return a state with the limit in force: a process without hardware does not report it."""
        if state.pace.speed_limit == self._config.speed_limit:
            return state
        return replace(state, pace=replace(state.pace, speed_limit=self._config.speed_limit))

    def _take_state(self, state: ArmState) -> None:
        self.state = state = self._with_speed_limit(state)
        self._state_at_s = time.monotonic()
        if state.position_rad is not None:
            self._last_connected = state
        # While it is still being checked or switched on, the arm's first real state is yet to come.
        if state.mode is not Mode.CONNECTED or state.reason:
            self._first_state.set()
        self._answer_held()
        self._on_state(state)

    def _exited(self) -> None:
        ran_s = 0.0 if self._heard_since_s is None else time.monotonic() - self._heard_since_s
        hung = self._silent_heartbeats > SILENT_HEARTBEATS
        halted = f"the arm process was silent for {SILENT_S:g} s" if hung else ""
        self._heard_since_s, self._silent_heartbeats = None, 0
        self._answer_held()
        for motion_id, motion in list(self._motions.items()):
            _settle(motion, MotionEnded(motion_id, Outcome.PROCESS_LOST, "the arm process ended during the motion"))
        for number, answered in list(self._orders.items()):
            _settle(answered, CommandDone(number, done=False, message="the arm process ended before it had answered"))
        if self._closing:
            return
        self._log_restart("the arm process ended; starting it again")
        self._restart = asyncio.create_task(self._start_again(ran_s), name="restart arm process")
        self._disconnect("the arm process ended and is starting again", STARTING_ARM, halted)

    async def _start_again(self, ran_s: float) -> None:
        await self._process.kill()
        # A fault stays latched. An arm that holds is adopted; a relaxed arm, perhaps relaxed by an emergency stop, must
        # not be switched on.
        last = self._last_connected
        clock = ClockReading(self.clock_s, self.state.stamp_s)
        hardware = self._config.hardware.resumed(_position_rad(last), clock, driven=last.torque_enabled)
        self._config = replace(self._config, hardware=hardware, start_enabled=False, fault=self.state.fault)
        while True:
            await asyncio.sleep(self._restart_delay.after(ran_s))
            # Python 3.11's wait_for may swallow the cancellation (bpo-37658).
            if self._closing or await self._launched_again():
                return
            ran_s = 0.0

    async def _launched_again(self) -> bool:
        try:
            await self._process.launch()
        except Exception as error:  # noqa: BLE001 - OSError, MemoryError and others; without a next try the arm is lost
            reason = f"the arm process cannot be started: {str(error) or type(error).__name__}"
            self._log_restart(reason)
            self._disconnect(f"{reason}; it is tried again")
            return False
        if self._begun:
            self._configure()
        return True

    def _disconnect(self, reason: str, task: str = "", halted: str = "") -> None:
        names, fault = self.state.joint_names, self.state.fault
        # A clock that is ahead of the machine's must not go back.
        stamp_s = time.time() if self.rate == 1.0 else self.state.stamp_s
        state = ArmState(stamp_s, Mode.DISCONNECTED, names, reason, task, fault=fault, clock_s=self.clock_s)
        state = replace(state, halted=halted, last_stop=self.last_stop, stopped=self._stopped)
        try:
            self._take_state(state)
        except Exception:  # a bug in one who takes the state must not end the restarts
            log.exception("reporting that the arm process is gone failed")

    def _log_restart(self, line: str) -> None:
        self._restart_log.write(log, logging.ERROR, line, line, time.monotonic())


class ArmStream:
    """Stream of velocity setpoints to some joints, in their order."""

    def __init__(
        self,
        motion_id: int,
        joint_names: tuple[str, ...],
        ended: asyncio.Future[MotionEnded],
        send: Callable[[Setpoint], None],
    ) -> None:
        self._motion_id = motion_id
        self._send = send
        self.joint_names = joint_names
        self.ended = ended
        self.commanded: Commanded | None = None  # latest goals of the joints; None until the arm has begun

    def steer(self, velocity_rad_s: Vector) -> None:
        """Set the joints' velocities, shape (joints,) [rad/s]; without a next setpoint the stream ends soon."""
        if not self.ended.done():
            self._send(Setpoint(self._motion_id, velocity_rad_s))


class ArmProcess:
    """Arm process, configured before it takes anything, and launched again after its end."""

    def __init__(
        self,
        on_message: Callable[[Any], None],
        on_exit: Callable[[], None],
        started: StartedChild | None = None,
        name: str = "",
    ) -> None:
        self._started, self._name = started, name
        self._reserve = DescriptorReserve()
        self._on_message = on_message
        self._on_exit = on_exit
        self._child: Child | None = None
        self._configured = False
        self.ended: asyncio.Future[None] | None = None  # end of the latest process; None before the first launch

    @property
    def pid(self) -> int | None:
        return None if self._child is None else self._child.pid

    @property
    def configured(self) -> bool:
        """True while a process runs that has its configuration."""
        return self._configured and self._child is not None and self._child.running

    async def launch(self) -> None:
        """Start a process; it does nothing before :meth:`configure`."""
        with self._reserve.lent():
            started, self._started = self._started or start_arm_process(self._name), None
            self._child = Child(started, on_message=self._on_message, on_exit=self._exited)
            self.ended = asyncio.get_running_loop().create_future()
        await self._child.connect()

    def configure(self, config: ArmConfig) -> None:
        """Send a running process its configuration."""
        if self._child is not None and self._child.running:
            self._configured = True
            self._child.send(config)

    def send(self, message: object) -> None:
        """Send a message; dropped while no configured process runs."""
        if self._child is not None and self._configured:
            self._child.send(message)

    @property
    def ending(self) -> str:
        return "it was never started" if self._child is None else self._child.ending

    async def leave(self) -> None:
        """Wait until a process that has closed its channel is gone; kill it when it stays."""
        if self._child is not None:
            await self._child.wait(SILENT_S)

    def close(self) -> None:
        self._reserve.close()

    async def kill(self) -> None:
        if self._child is not None:
            await self._child.kill()

    def _exited(self) -> None:
        self._configured = False
        if self.ended is not None and not self.ended.done():
            self.ended.set_result(None)
        # The socket of this process, which is closed behind this call, belongs to the next one.
        asyncio.get_running_loop().call_soon(self._reserve.fill)
        self._on_exit()


def _epoch_of_request(epoch: int | None) -> int:
    return STOP_EPOCHS.present if epoch is None else epoch


def _position_rad(state: ArmState) -> dict[str, float]:
    """Return goals of a driven arm, else positions, by joint [rad]; empty for an arm that was never read."""
    held_rad = state.goal_rad if state.torque_enabled else state.position_rad
    return {} if held_rad is None else dict(zip(state.joint_names, held_rad.tolist(), strict=True))


def _settle(waiting: asyncio.Future[Ending] | None, answer: Ending) -> None:
    if waiting is not None and not waiting.done():
        waiting.set_result(answer)
