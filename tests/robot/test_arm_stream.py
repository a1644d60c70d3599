from __future__ import annotations

import asyncio

import numpy as np

from robot.arm_stream import ArmStream
from robot.messages import MotionEnded, Outcome, Setpoint


async def test_setpoints_go_out_under_the_streams_number_until_it_has_ended() -> None:
    sent: list[Setpoint] = []
    ended: asyncio.Future[MotionEnded] = asyncio.get_running_loop().create_future()
    stream = ArmStream(5, ("shoulder_pan",), ended, sent.append)
    stream.steer(np.array([0.3]))
    ended.set_result(MotionEnded(5, Outcome.STOPPED, "stopped"))
    stream.steer(np.array([0.4]))
    assert [(each.motion_id, each.velocity_rad_s.tolist()) for each in sent] == [(5, [0.3])]
