"""An arm process without the process: the supervisor, driven tick by tick on a real bus."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from robot import model
from robot.calibration import Calibration
from robot.control.pacing import Pacer
from robot.control.supervisor import Supervisor
from robot.limits import within_calibration
from robot.messages import (
    ArmConfig,
    ArmHealth,
    ArmState,
    Command,
    CommandDone,
    Execute,
    Heartbeat,
    Mode,
    MotionEnded,
    Order,
)
from robot.servos.bus import Bus
from robot.servos.registers import Register
from robot.trajectory import Trajectory

CALIBRATION = Calibration.nominal()
ROBOT = within_calibration(model.builtin(), CALIBRATION)
CONFIG = ArmConfig(ROBOT, CALIBRATION, port="")

# A tick's room on the bus is 10 ms; sequences are worked at until so much is left.
STEP_ROOM_S = 0.002


class ArmRig:
    """A supervisor on a bus; time is real, since the emulator's is."""

    def __init__(self, port: str, **settings: Any) -> None:
        self.port = port
        self.sent: list[object] = []
        self.alive = True
        self.supervisor = Supervisor(
            replace(CONFIG, port=port, **settings),
            lambda message, _: self.sent.append(message),
            time.monotonic(),
            real_time=False,
        )
        self.bus: Bus | None = None
        self.pacer = Pacer(time.monotonic())
        self._numbers = 0
        self.connect()

    def connect(self) -> None:
        self.bus = Bus.open(self.port)
        self.supervisor.connect(self.bus, time.monotonic())
        self.pacer = Pacer(time.monotonic())

    def close(self) -> None:
        if self.bus is not None:
            self.bus.close()

    @property
    def mode(self) -> Mode:
        return self.supervisor.mode

    @property
    def fault_code(self) -> str:
        return "" if self.supervisor.fault is None else self.supervisor.fault.code.value

    @property
    def state(self) -> ArmState:
        return next(message for message in reversed(self.sent) if isinstance(message, ArmState))

    @property
    def health(self) -> ArmHealth:
        return next(message for message in reversed(self.sent) if isinstance(message, ArmHealth))

    @property
    def ended(self) -> list[MotionEnded]:
        return [message for message in self.sent if isinstance(message, MotionEnded)]

    def tick(self) -> None:
        """One period of the loop."""
        while (remaining_s := self.pacer.deadline_s - time.monotonic()) > 0.0:
            wait_s = (
                min(remaining_s, self.supervisor.work(time.monotonic())) if remaining_s > STEP_ROOM_S else remaining_s
            )
            time.sleep(max(wait_s, 0.0))
        now_s = time.monotonic()
        self.pacer.start_tick(now_s)
        if self.alive:
            self.supervisor.obey(Heartbeat(), now_s)
        self.supervisor.tick(now_s, self.pacer, server_gone=False)

    def run(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.tick()

    def until(self, condition: Callable[[], bool], timeout_s: float = 6.0) -> None:
        until_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < until_s, f"timed out in {self.mode}, {self.supervisor.fault}"
            self.tick()

    def until_mode(self, mode: Mode) -> None:
        self.until(lambda: self.mode is mode)

    def begin(self, order: Order) -> int:
        """Give an order; returns its number."""
        self._numbers += 1
        self.supervisor.obey(Command(self._numbers, order), time.monotonic())
        return self._numbers

    def answer(self, number: int) -> CommandDone | None:
        answers = [each for each in self.sent if isinstance(each, CommandDone) and each.number == number]
        assert len(answers) <= 1, "an order was answered twice"
        return answers[0] if answers else None

    def order(self, order: Order) -> CommandDone:
        """Give an order and wait for its answer."""
        number = self.begin(order)
        self.until(lambda: self.answer(number) is not None)
        answer = self.answer(number)
        assert answer is not None
        return answer

    def execute(self, trajectory: Trajectory, motion_id: int = 1, **options: Any) -> None:
        self.supervisor.obey(Execute(motion_id, trajectory, **options), time.monotonic())

    def torque(self) -> list[int]:
        """Register TORQUE_ENABLE of every servo."""
        assert self.bus is not None
        return [self.bus.read(servo, Register.TORQUE_ENABLE) for servo in self.supervisor.servos.ids]
