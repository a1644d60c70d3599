"""The server's own record of an arm's motion, as the judge of what a page says and does."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from websockets.exceptions import ConnectionClosed
from websockets.sync import client as blocking

from harness.waiting import TIMEOUT_S, wait_until

# The emulated servos' readings jitter by less; a jogged joint goes this way in a tenth of a second.
MOVED_RAD = 0.05

# An arm that rests has gone less in this time, by at least so many of its states. What is held is sent every 25 ms.
STILL_RAD, REST_S, REST_STATES = 0.02, 0.5, 4

# Farther than any joint goes while it brakes.
BRAKING_RAD = 0.3

# After this the input is let go, for longer than the servo node takes for a pause of the program's own [s].
PRESSED_S, LET_GO_S = 5.0, 0.4


class ArmRecord:
    """Every joint state that the server publishes, with its stamp: a busy machine delivers states late."""

    def __init__(self, websocket: blocking.ClientConnection) -> None:
        self._websocket = websocket
        self._states: list[tuple[float, list[float]]] = []

    def keep(self) -> None:
        """Record until the connection is closed."""
        try:
            for frame in self._websocket:
                msg = json.loads(frame)["msg"]
                stamp = msg["header"]["stamp"]
                self._states.append((stamp["sec"] + 1e-9 * stamp["nanosec"], msg["position"]))
        except ConnectionClosed:
            return

    def way_rad(self, since_s: float) -> float:
        """Return the longest way of any joint since a time of the wall clock, there and back counted as there [rad]."""
        positions = [position for stamp_s, position in list(self._states) if stamp_s >= since_s]
        return max((max(values) - min(values) for values in zip(*positions, strict=True)), default=0.0)

    def until_rest(self, way_rad: float = BRAKING_RAD) -> None:
        """Wait until the arm has stood for a while, after a short way from where it is now."""
        since_s = time.time()
        wait_until(lambda: self._rests(since_s))
        assert self.way_rad(since_s) < way_rad

    def _rests(self, since_s: float) -> bool:
        stamps_s = [stamp_s for stamp_s, _ in list(self._states) if stamp_s >= since_s]
        before = [stamp_s for stamp_s in stamps_s if stamp_s < stamps_s[-1] - REST_S][-1:]
        lately = [stamp_s for stamp_s in stamps_s if [stamp_s] > before]
        return bool(before) and len(lately) >= REST_STATES and self.way_rad(before[0]) < STILL_RAD


@contextmanager
def arm_record(url: str) -> Iterator[ArmRecord]:
    """Record an arm while the block lasts."""
    with blocking.connect(url) as websocket:
        websocket.send(json.dumps({"op": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/JointState"}))
        record = ArmRecord(websocket)
        reader = threading.Thread(target=record.keep, daemon=True)
        reader.start()
        yield record
    reader.join(5.0)


def hold_until(condition: Callable[[], object], press: Callable[[], object], let_go: Callable[[], object]) -> None:
    """Press an input until a condition, and keep it pressed; the servo node of a busy machine may end a press."""
    until_s = time.monotonic() + TIMEOUT_S
    while True:
        press()
        pressed_s = time.monotonic()
        while time.monotonic() < pressed_s + PRESSED_S:
            if condition():
                return
            time.sleep(0.02)
        assert time.monotonic() < until_s, "the arm does not move as it should"
        let_go()
        time.sleep(LET_GO_S)
