"""The reference for the servo loop: a process of the same priority that only waits for the same deadlines."""

from __future__ import annotations

import json
import sys
import time

from robot.control.pacing import Pacer
from robot.control.realtime import enter_realtime


def lateness_s(seconds: float) -> list[float]:
    """Tick for a while and return the lateness of each tick [s]."""
    enter_realtime()
    until_s = time.monotonic() + seconds
    pacer, found = Pacer(time.monotonic()), []
    while pacer.deadline_s < until_s:
        time.sleep(max(0.0, pacer.deadline_s - time.monotonic()))
        pacer.start_tick(time.monotonic())
        found.append(pacer.lateness_s[-1])
    return found


if __name__ == "__main__":
    print(json.dumps(lateness_s(float(sys.argv[1]))))
