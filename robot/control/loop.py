"""The arm process: opens the bus, and gives the supervisor its ticks, 100 a second, and the server's messages.

Nothing else runs here, so neither a planner's lock nor a burst of messages can delay a tick. When the server asks
for the end, or is gone, the arm is brought to its end state and the process ends.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

from robot.channel import Channel, channel_of_child
from robot.control.config_check import checked
from robot.control.pacing import Pacer, become_punctual
from robot.control.supervisor import Supervisor
from robot.errors import RobotError
from robot.messages import ArmConfig, Command, Order
from robot.servos.bus import Bus
from robot.servos.discovery import resolve_port

# Between attempts to open a port that is not there.
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 2.0

# A step of a sequence takes a transaction, 1 to 2 ms; none is begun when less is left until the tick.
STEP_ROOM_S = 0.002


class ArmLoop:
    """Owns the port and the channel.

    Args:
        channel: the server.
        config: the arm; the joints of its calibration are the order of every array.
        real_time: whether the process has real-time priority.
    """

    def __init__(self, channel: Channel, config: ArmConfig, *, real_time: bool) -> None:
        self._channel = channel
        self._port = config.port
        self._look_now = False
        self._supervisor = Supervisor(config, self._send, time.monotonic(), real_time=real_time)

    def run(self) -> None:
        """Serve until the end; an arm that is not there is tried again and again."""
        retry_s = FIRST_RETRY_S
        while not self._finished():
            try:
                with contextlib.closing(Bus.open(resolve_port(self._port))) as bus:
                    self._supervisor.connect(bus, time.monotonic())
                    retry_s = FIRST_RETRY_S
                    self._drive()
            except RobotError as error:
                self._supervisor.disconnect(str(error))
                self._wait(retry_s)
                retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)

    def _drive(self) -> None:
        """Run ticks until the end; raises RobotError when the bus is lost."""
        pacer = Pacer(time.monotonic())
        while not self._finished():
            self._between_ticks(pacer.deadline_s)
            now_s = time.monotonic()
            pacer.start_tick(now_s)
            self._supervisor.tick(now_s, pacer, server_gone=self._channel.closed)

    def _finished(self) -> bool:
        return self._supervisor.finished(time.monotonic())

    def _between_ticks(self, deadline_s: float) -> None:
        """Take the server's messages, and do what orders ask for, until the tick is due."""
        self._obey(self._channel.receive(0.0))
        while (remaining_s := deadline_s - time.monotonic()) > 0.0:
            idle_s = remaining_s
            if remaining_s > STEP_ROOM_S:
                idle_s = min(remaining_s, self._supervisor.work(time.monotonic()))
            if self._channel.closed:
                time.sleep(max(0.0, idle_s))
            else:
                self._obey(self._channel.receive(idle_s))

    def _obey(self, messages: list[Any]) -> None:
        """Obey emergency stops first, the rest in order."""
        for message in sorted(messages, key=_rank):
            if isinstance(message, ArmConfig):
                # When its bus is lost, the arm is to be found elsewhere.
                self._port, self._look_now = message.port, True
            self._supervisor.obey(message, time.monotonic())

    def _send(self, message: object, droppable: bool) -> None:
        self._channel.send(message, droppable=droppable)

    def _wait(self, wait_s: float) -> None:
        """Answer the server while there is no bus, until it is time to look for one again."""
        until_s = time.monotonic() + wait_s
        self._look_now = False
        while not (self._finished() or self._look_now) and (remaining_s := until_s - time.monotonic()) > 0.0:
            if self._channel.closed:
                self._supervisor.lose_server()
            else:
                self._obey(self._channel.receive(remaining_s))


def _rank(message: object) -> int:
    return 0 if isinstance(message, Command) and message.order is Order.EMERGENCY_STOP else 1


def main() -> None:
    """Run the arm process: the first message is its configuration."""
    channel = channel_of_child()
    config = channel.receive_first()
    if config is not None:
        ArmLoop(channel, checked(config), real_time=become_punctual()).run()


if __name__ == "__main__":
    main()
