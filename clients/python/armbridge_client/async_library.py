"""Kept on the server: named states, taught motions, and episodes of recordings."""

from __future__ import annotations

import json

from armbridge_client.connection import CALL_TIMEOUT_S, Connection
from armbridge_client.messages import (
    BeginTeachingRequest,
    CheckMotionRequest,
    CheckMotionResponse,
    DeleteMotionRequest,
    DeleteRobotStateFromWarehouseRequest,
    EndTeachingRequest,
    EndTeachingResponse,
    ListMotionsRequest,
    RenameMotionRequest,
    ReplayMotionGoal,
    ReplayMotionResult,
    SaveRobotStateToWarehouseRequest,
    StartEpisodeRequest,
    String,
    TriggerRequest,
    TrimMotionRequest,
)
from armbridge_client.motion import check_code
from armbridge_client.wire import from_wire

REPLAY_TIMEOUT_S = 600.0


class AsyncNamedStates:
    """Named states: targets of ``move_named``, of the robot's description or saved."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    async def all(self) -> dict[str, dict[str, float]]:
        """Return the joint positions of every state by name [rad, or m for joints that slide]."""
        async with self._connection.subscribe("/named_states", String) as texts:
            states = json.loads((await texts.__anext__()).data)
        return {name: state["joints"] for name, state in states.items()}

    async def save(self, name: str) -> None:
        """Save the present position under a name; needs the role admin."""
        await self._connection.carry_out("/save_robot_state", SaveRobotStateToWarehouseRequest(name))

    async def delete(self, name: str) -> None:
        """Delete a saved state; needs the role admin."""
        await self._connection.carry_out("/delete_robot_state", DeleteRobotStateFromWarehouseRequest(name))


class AsyncTeaching:
    """Motions taught by hand: relax the arm, hold it, ``begin``, lead it, ``end``."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    async def begin(self, name: str, *, group: str = "") -> str:
        """Begin to record a motion under a new name; an empty group is the default group and the gripper."""
        return (await self._connection.carry_out("/teach/begin", BeginTeachingRequest(name, group))).message

    async def end(self, timeout_s: float = 30.0) -> EndTeachingResponse:
        """End the recording, and make it a motion; the message names contacts in the present scene."""
        return await self._connection.carry_out("/teach/end", EndTeachingRequest(), timeout_s)

    async def discard(self) -> str:
        """End the recording, and keep nothing."""
        return (await self._connection.carry_out("/teach/discard", TriggerRequest())).message

    async def names(self) -> list[str]:
        """Return the names of all motions."""
        return (await self._connection.call("/teach/list", ListMotionsRequest())).names

    async def check(self, name: str, speed: float = 1.0, timeout_s: float = 30.0) -> CheckMotionResponse:
        """Check if a replay would touch something now, and how long it would take."""
        return await self._connection.call("/teach/check", CheckMotionRequest(name, speed), timeout_s)

    async def replay(
        self,
        name: str,
        *,
        speed: float = 1.0,
        reverse: bool = False,
        repeat: int = 0,
        timeout_s: float = REPLAY_TIMEOUT_S,
    ) -> str:
        """Go to the start of a motion by a planned motion, and replay the motion.

        Args:
            speed: share of the taught speed, above 0 to 2.
            reverse: from the end to the start.
            repeat: number of replays after the first, 0 to 100.

        Raises:
            GoalRefused: the replay would touch something, or was stopped.
        """
        goal = ReplayMotionGoal(name, speed, reverse, repeat)
        result = from_wire(ReplayMotionResult, await self._connection.perform("/replay_motion", goal, timeout_s))
        result.error_code.message = result.message
        check_code(result.error_code)
        return result.message

    async def trim(self, name: str, from_s: float, to_s: float) -> str:
        """Keep the part of a motion between two times; needs the role admin."""
        return (await self._connection.carry_out("/teach/trim", TrimMotionRequest(name, from_s, to_s))).message

    async def rename(self, name: str, new_name: str) -> str:
        """Rename a motion; needs the role admin."""
        return (await self._connection.carry_out("/teach/rename", RenameMotionRequest(name, new_name))).message

    async def delete(self, name: str) -> str:
        """Delete a motion; needs the role admin."""
        return (await self._connection.carry_out("/teach/delete", DeleteMotionRequest(name))).message


class AsyncEpisodes:
    """Episodes of the server's recording, from which datasets are made (``armbridge serve --record``)."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    async def start(self, task: str) -> str:
        """Begin an episode of a task, a sentence of at most 300 characters."""
        return (await self._connection.carry_out("/dataset/start_episode", StartEpisodeRequest(task))).message

    async def stop(self, timeout_s: float = CALL_TIMEOUT_S) -> str:
        """End the episode; the sentence names cameras that were silent."""
        return (await self._connection.carry_out("/dataset/stop_episode", TriggerRequest(), timeout_s)).message

    async def discard(self) -> str:
        """Drop the episode in progress, or else the last one."""
        return (await self._connection.carry_out("/dataset/discard_episode", TriggerRequest())).message
