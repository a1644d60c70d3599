"""Session with the armbridge server: the connection, remembered answers, and the motion that waits for approval."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from armbridge_client import AsyncArm, AsyncPlan, GoalRefused, Target, after_stop, connect_async
from armbridge_client.messages import (
    CompressedImage,
    GetPositionFKRequest,
    GoalTarget,
    JointState,
    Point,
    PoseStamped,
    RobotState,
    TopicsForTypeRequest,
)
from armbridge_mcp.limits import LimitError, Region, samples

# A person decides within this time, as in the server's confirm mode [s].
APPROVAL_S = 120.0
# A goal of the role propose waits as long on the server, and then moves [s].
PROPOSAL_S = 300.0

MAX_POSES = 100
MAX_IMAGE_BYTES = 2_000_000
IMAGE_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Options:
    """Options of the command.

    Attributes:
        asks: True where each motion needs a person's approval.
        max_speed: most of the joints' velocity limits, above 0 to 1.
    """

    url: str
    arm: str = ""
    asks: bool = True
    max_speed: float = 0.2
    region: Region | None = None


# Count of stops by this program's tool, and the number of the server's last stop.
Stops = tuple[int, int]


@dataclass(frozen=True)
class Question:
    """Question about a motion that waits for a person's answer.

    Attributes:
        stops: the stops before it was asked.
        until_s: time at which it expires, by the session's clock [s].
    """

    text: str
    stops: Stops
    until_s: float


class Session:
    """Connection to the arm, made with the first request and kept.

    Attributes:
        poses: remembered joint positions by name [rad].
    """

    def __init__(self, options: Options, clock: Callable[[], float] = time.monotonic) -> None:
        self.options = options
        self.poses: dict[str, Mapping[str, float]] = {}
        self.moving = asyncio.Lock()
        self._clock = clock
        self._connecting = asyncio.Lock()
        self._arm: AsyncArm | None = None
        self._question: Question | None = None
        self._own_stops = 0

    async def close(self) -> None:
        """Disconnect; the server stops this client's motions."""
        if self._arm is not None:
            await self._arm.close()

    async def arm(self) -> AsyncArm:
        """Return the arm.

        Raises:
            ArmError: the server cannot be reached, or refuses the client.
        """
        async with self._connecting:
            if self._arm is None:
                options = self.options
                self._arm = await connect_async(options.url, arm=options.arm)
            return self._arm

    async def proposes(self) -> bool:
        """Return True where the server has each motion approved by another client."""
        return (await self.arm()).server.role == "propose"

    # Approval.

    async def ask(self, text: str) -> None:
        """Note that a person is asked about a motion; one is asked about at a time.

        Raises:
            LimitError: another motion waits for its answer.
        """
        waiting = self._question
        if waiting is not None and self._clock() < waiting.until_s:
            if waiting.text != text:
                raise LimitError(f"another motion waits for approval: {waiting.text} Wait for its answer, or call stop")
            return
        self._question = Question(text, await self.stops(), self._clock() + APPROVAL_S)

    def take_answer(self, *, accepted: bool) -> Stops:
        """Take a person's answer; return the stops before the person was asked.

        Raises:
            LimitError: the motion may not begin.
        """
        question, self._question = self._question, None
        if not accepted:
            raise LimitError("the person did not approve this motion; ask what they want instead")
        if question is None or self._clock() >= question.until_s:
            raise LimitError(
                f"the approval came after a stop, or later than {APPROVAL_S:g} s: nothing moved; ask again"
            )
        return question.stops

    def note_stop(self) -> None:
        """Note that the arm is being stopped; motions that wait or are planned do not begin."""
        self._own_stops += 1
        self._question = None

    async def stops(self) -> Stops:
        """Return the stops so far, with every stop of this program that was noted before this call."""
        own = self._own_stops
        return own, await (await self.arm()).stops()

    def after(self, before: Stops) -> contextlib.AbstractContextManager[None]:
        """Return the context for the request of a motion, which the server refuses if the arm was stopped meanwhile.

        Raises:
            LimitError: this program is about to stop the arm.
        """
        own, stops = before
        if own != self._own_stops:
            raise LimitError("the arm was stopped before this motion began: nothing moved; ask again")
        return after_stop(stops)

    async def named(self) -> Mapping[str, Mapping[str, float]]:
        """Return the server's named states: joint positions by name [rad]."""
        return await (await self.arm()).named_states.all()

    async def pose(self) -> Mapping[str, float]:
        """Return the present positions of the joints that named states have [rad]; of all joints without any state."""
        position_rad = (await (await self.arm()).state()).position_rad
        joints = {joint for state in (await self.named()).values() for joint in state} or position_rad.keys()
        return {name: value for name, value in position_rad.items() if name in joints}

    # Motions.

    async def plan(self, target: Target, speed: float) -> AsyncPlan:
        """Plan a motion and check its path against the region.

        Raises:
            GoalRefused: there is no such motion.
            LimitError: the tip would leave the region.
        """
        arm = await self.arm()
        planned = await arm.plan(target, speed=speed)
        region = self.options.region
        if region is not None:
            trajectory = planned.trajectory.joint_trajectory
            for index in samples(len(trajectory.points)):
                positions = trajectory.points[index].positions
                region.check(await self._tip_at(trajectory.joint_names, positions), "the tip's path")
        return planned

    async def _tip_at(self, names: list[str], positions: list[float]) -> tuple[float, float, float]:
        arm = await self.arm()
        state = RobotState(JointState(name=names, position=positions))
        request = GetPositionFKRequest(fk_link_names=[arm.info.tip], robot_state=state)
        answer = await arm.connection.call("/compute_fk", request)
        if not answer.pose_stamped:
            raise LimitError(f"the tip's position on the path is unknown: {answer.error_code.message}")
        return coordinates(answer.pose_stamped[0].pose.position)

    # Cameras.

    async def image(self, camera: str) -> tuple[CompressedImage | None, list[str]]:
        """Return an image of a camera, or of the first one, and the topics of all cameras."""
        arm = await self.arm()
        request = TopicsForTypeRequest(CompressedImage.TYPE)
        topics = sorted((await arm.connection.call("/rosapi/topics_for_type", request)).topics)
        topic = camera or (topics[0] if topics else "")
        if topic not in topics:
            return None, topics
        async with arm.connection.subscribe(topic, CompressedImage, timeout_s=IMAGE_TIMEOUT_S) as images:
            return await images.__anext__(), topics


def coordinates(point: Point) -> tuple[float, float, float]:
    """Return x, y and z of a point."""
    return point.x, point.y, point.z


def suggestion_of(refused: GoalRefused) -> str:
    """Return the goal that would work instead, as arguments of the tools; empty if none is known."""
    found: GoalTarget | None = refused.suggestion
    if found is None:
        return ""
    if found.named:
        return f"named={found.named!r}"
    if found.joints.name:
        joints = {name: round(value, 3) for name, value in zip(found.joints.name, found.joints.position)}
        return f"joints={joints}"
    return point_text(found.pose)


def point_text(pose: PoseStamped) -> str:
    """Return a point as arguments of the tools."""
    return ", ".join(f"{axis}={value:.3f}" for axis, value in zip("xyz", coordinates(pose.pose.position)))
