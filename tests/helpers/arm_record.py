"""The server's own record of an arm's motion, as the judge of what a page says and does."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from websockets.exceptions import ConnectionClosed
from websockets.sync import client as blocking

# The emulated servos' readings jitter by less; a jogged joint goes this way in a tenth of a second.
MOVED_RAD = 0.05


class ArmRecord:
    """Every joint state that the server publishes, with the time of its arrival."""

    def __init__(self, websocket: blocking.ClientConnection) -> None:
        self._websocket = websocket
        self._samples: list[tuple[float, list[float]]] = []

    def keep(self) -> None:
        """Record until the connection is closed."""
        try:
            for frame in self._websocket:
                self._samples.append((time.monotonic(), json.loads(frame)["msg"]["position"]))
        except ConnectionClosed:
            return

    def way_rad(self, since_s: float) -> float:
        """Return the longest way of any joint since a time, there and back counted as there [rad]."""
        positions = [position for at_s, position in list(self._samples) if at_s >= since_s]
        return max((max(values) - min(values) for values in zip(*positions, strict=True)), default=0.0)

    def stands(self, for_s: float) -> bool:
        """Watch the arm for a time; return true if no joint moves."""
        began_s = time.monotonic()
        time.sleep(for_s)
        assert any(at_s > began_s for at_s, _ in list(self._samples)), "the server publishes no joint states"
        return self.way_rad(began_s) < MOVED_RAD


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
