"""MoveIt's interface on a graph of its own: complete messages, a scene, services and actions, and a planner."""

from __future__ import annotations

import asyncio
import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from harness.waiting import TIMEOUT_S
from planners import problem
from planners.problem import MoveItErrorCode, PlanningFailure, Request
from planners.scene import EMPTY_SCENE, Pose, Scene
from protocol.messages import Stamp, complete
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from server.errors import RefusedError
from server.execution import goal as execution
from server.execution.confirmation import Confirmation
from server.execution.goal import Answer, GoalPolicy
from server.execution.monitors import CurrentState
from server.execution.queue import GoalListener, GoalQueue
from server.graph.actions import ActionGoal, Result
from server.graph.permissions import Node
from server.graph.topics import Graph, LocalGraph
from server.moveit.display import DisplayTopics
from server.moveit.goals.goal_topics import GoalTranslator
from server.moveit.named_states import NamedStates
from server.moveit.parameters import MoveItParameters, PlannerParameters
from server.moveit.requests.constraints import RequestContext
from server.moveit.requests.planning_context import GoalContext, PlanningContext
from server.moveit.scene.frames import Frames, LinkTransforms
from server.moveit.scene.planning_scene import SceneDraft
from server.moveit.scene.scene_state import AssumedStates, SceneState
from server.moveit.services.move_group_services import offer_services
from tests.helpers.fake_arm import JOINTS, FakeArm, settle
from tests.helpers.goal_runner import GoalRunner
from tests.helpers.graph import listen
from tests.helpers.messages import REGISTRY
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF, so101

if TYPE_CHECKING:
    from planners.pipeline import Planner

ROBOT = so101()
BENT = dict.fromkeys(JOINTS, 0.2)
FORWARD = ForwardPlacements(ROBOT)
Quaternion = tuple[float, float, float, float]


def message(type_name: str, **fields: Any) -> dict[str, Any]:
    """A complete message of moveit_msgs or, where the name says so, of another package."""
    name = type_name if "/" in type_name else f"moveit_msgs/{type_name}"
    return complete(REGISTRY, name, fields, Stamp(0, 0))


def pose(
    x: float = 0.0, y: float = 0.0, z: float = 0.0, *, turned: Quaternion = (0.0, 0.0, 0.0, 1.0)
) -> dict[str, Any]:
    """A geometry_msgs/Pose."""
    return {"position": {"x": x, "y": y, "z": z}, "orientation": dict(zip("xyzw", turned, strict=True))}


def box(name: str, *, at: dict[str, Any] | None = None, frame: str = "", **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/CollisionObject that adds a cube with edges of 5 cm."""
    cube = {"type": 1, "dimensions": [0.05, 0.05, 0.05]}
    return {"id": name, "primitives": [cube], "pose": at or pose(), "header": {"frame_id": frame}, **fields}


def collision_object(**fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/CollisionObject."""
    return message("CollisionObject", **fields)


def held(name: str, link: str = "gripper_link", *, touch_links: tuple[str, ...] = (), **fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/AttachedCollisionObject."""
    told = {"link_name": link, "touch_links": list(touch_links), "object": {"id": name, **fields}}
    return message("AttachedCollisionObject", **told)


def diff(**fields: Any) -> dict[str, Any]:
    """A complete moveit_msgs/PlanningScene that is a difference; so is its robot_state unless it says otherwise."""
    state = {"is_diff": True, **fields.pop("robot_state", {})}
    return message("PlanningScene", is_diff=True, robot_state=state, **fields)


def scene_state(*objects: dict[str, Any]) -> SceneState:
    """A scene in which objects stand around."""
    state = SceneState(ROBOT)
    state.apply_diff(diff(world={"collision_objects": list(objects)}), BENT)
    return state


def draft(*objects: dict[str, Any]) -> SceneDraft:
    """The same scene while it is being changed."""
    return SceneDraft(scene_state(*objects).contents, LinkTransforms(ROBOT, FORWARD, BENT))


def rejection(function: Callable[..., object], *arguments: object, **named: object) -> PlanningFailure:
    """The failure of a call that must be rejected."""
    with pytest.raises(RefusedError) as raised:
        function(*arguments, **named)
    return raised.value.failure


def current_state(position_rad: float = 0.2) -> CurrentState:
    """Return the state of an arm whose joints all are at a position."""
    return CurrentState(FakeArm(dict.fromkeys(JOINTS, position_rad)))


SEVEN = model.parse(SEVEN_JOINT_URDF, SEVEN_JOINT_SRDF)
TIP = "gripper_frame_link"
FRAMES = Frames(SceneState(ROBOT))
BOX, SPHERE, CYLINDER, CONE = 1, 2, 3, 4


def context(robot=ROBOT, start_rad=None, group="arm", **parameters: Any) -> RequestContext:
    start_rad = {joint.name: 0.0 for joint in robot.movable_joints} | (start_rad or {})
    frames = FRAMES if robot is ROBOT else Frames(SceneState(robot))
    group_model = robot.groups.get(group) or next(iter(robot.groups.values()))
    return RequestContext(robot, group_model, frames, start_rad, MoveItParameters(**parameters))


def point(x: float, y: float, z: float, **orientation: float) -> dict[str, Any]:
    """A geometry_msgs/Pose."""
    return {"position": {"x": x, "y": y, "z": z}, "orientation": orientation}


def region(*primitives: tuple[int, list[float]], poses: list[dict[str, Any]], **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/PositionConstraint."""
    solids = [{"type": kind, "dimensions": dimensions} for kind, dimensions in primitives]
    return {"constraint_region": {"primitives": solids, "primitive_poses": poses}, **fields}


def ball(x: float, y: float, z: float, radius_m: float = 0.005, **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/PositionConstraint of one sphere."""
    return region((SPHERE, [radius_m]), poses=[point(x, y, z)], **fields)


def turned(tolerance: float | tuple[float, float, float], **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/OrientationConstraint."""
    tolerances = tolerance if isinstance(tolerance, tuple) else (tolerance,) * 3
    names = (f"absolute_{axis}_axis_tolerance" for axis in "xyz")
    return {**dict(zip(names, tolerances, strict=True)), **fields}


def joint(name: str, position: float, above: float = 0.0, below: float = 0.0, **fields: Any) -> dict[str, Any]:
    """A moveit_msgs/JointConstraint."""
    return {"joint_name": name, "position": position, "tolerance_above": above, "tolerance_below": below, **fields}


def constraints(**fields: Any) -> dict[str, Any]:
    return message("Constraints", **fields)


def outcome(function: Callable[..., Any], *arguments: Any) -> Any:
    """The value of a call, or the failure that rejects it."""
    try:
        return function(*arguments)
    except RefusedError as error:
        return error.failure


def assert_refused(answer: object, code: MoveItErrorCode, *words: str) -> PlanningFailure:
    assert isinstance(answer, PlanningFailure), answer
    assert answer.code is code, answer
    for word in words:
        assert word in answer.message
    return answer


def near(pose: Pose, position_m: tuple[float, float, float], tolerance_m: float = 1e-9) -> bool:
    return all(abs(a - b) <= tolerance_m for a, b in zip(pose.position_m, position_m, strict=True))


def planning_of(
    arm: FakeArm, robot: RobotModel = ROBOT, *, pool: Any = None, graph: Graph | None = None, **parameters: Any
) -> PlanningContext:
    """Return the context of planning for an arm in an empty scene, in the time of the graph."""
    graph, scene = graph or Graph(REGISTRY), SceneState(robot)
    return PlanningContext(
        robot=robot,
        pool=pool,
        frames=Frames(scene),
        scene_state=scene,
        current=CurrentState(arm),
        assumed=AssumedStates(robot),
        parameters=PlannerParameters(MoveItParameters(**parameters)),
        display=DisplayTopics(graph, robot),
        clock=graph.clock,
        confirmation=Confirmation(graph, enabled=False, timeout_s=60.0),
    )


def goal_context(graph: Graph, arm: FakeArm, planning: PlanningContext, queue: Any, **parameters: Any) -> GoalContext:
    """Return the context of the goals of an only arm."""
    return GoalContext(
        graph=LocalGraph(graph),
        arm=arm.as_arm,
        robot=planning.robot,
        parameters=MoveItParameters(**parameters),
        planning=planning,
        queue=queue,
    )


def translator(
    arm: FakeArm | None = None, robot: RobotModel = ROBOT, planning: PlanningContext | None = None
) -> GoalTranslator:
    """Return a reader of goals of an arm, by default of one at home, in an empty scene, with one state saved."""
    states = NamedStates(robot, robot.default_group, Path("/no file"))
    states.saved = {"Mine": {"elbow_flex": 0.4, "gripper": 1.0}}
    return GoalTranslator(planning or planning_of(arm or FakeArm(), robot), MoveItParameters(), states)


TRANSLATOR = translator()


@functools.cache
def planner() -> Planner:
    """Return the planner, whose libraries are loaded by the first test that plans."""
    from planners.pipeline import Planner

    # Its searches get as far on every machine: each look at the clock takes 2 ms.
    return Planner(ROBOT, functools.partial(next, itertools.count(0.0, 0.002)))


class DirectPool:
    """Asks the planner at once."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    async def ask(self, request: Request, scene: Scene = EMPTY_SCENE) -> problem.Answer:
        if not self.requests:
            # Planners tell scenes apart by their versions, and the planner of all tests may have another test's scene.
            planner().set_scene(EMPTY_SCENE)
        self.requests.append(request)
        refusal = planner().set_scene(scene)
        return refusal if isinstance(refusal, PlanningFailure) else planner().answer(request)


class ServiceRig:
    """All of it, and a client."""

    def __init__(self) -> None:
        self.graph = Graph(REGISTRY)
        self.arm, self.pool = FakeArm(), DirectPool()
        self.client = Node("client", remote=True)
        self.context = planning_of(self.arm, pool=self.pool, graph=self.graph)
        self.scene_state, self.current = self.context.scene_state, self.context.current
        offer_services(self.graph, self.context)

    async def call(self, service: str, **request: Any) -> Any:
        """The values of the response; fails when the call failed."""
        ok, values = await self.outcome(service, **request)
        assert ok, values
        return values

    async def outcome(self, service: str, **request: Any) -> tuple[bool, Any]:
        """Return the success of a call and its values."""
        answered = asyncio.get_running_loop().create_future()
        self.graph.services.call(self.client, service, request, answered.set_result)
        response = await asyncio.wait_for(answered, TIMEOUT_S)
        return response.ok, response.values

    def listen(self, topic: str, type_name: str) -> list[Any]:
        """The messages that come on a topic from now on."""
        return listen(self.graph, topic, type_name)


class ActionDesk(ServiceRig, GoalRunner, GoalListener):
    """A queue, its runner, and a client that sends goals."""

    def __init__(self) -> None:
        ServiceRig.__init__(self)
        GoalRunner.__init__(self)
        self.refused: list[str] = []
        self.queue = GoalQueue(self, GoalPolicy.QUEUE, 4)
        self.queue.listeners.append(self)
        self.queue.start()
        self.feedback: list[dict[str, Any]] = []
        self.results: list[Result] = []

    def on_answer(self, goal: execution.Goal, answer: Answer) -> None:
        if goal.request.motion is None:
            self.refused.append(answer.message)

    async def send(self, action: str, **goal: Any) -> ActionGoal:
        """Send a goal, and let everything that it sets going come to rest."""
        type_name = self.graph.actions.names.type_of(action)
        assert type_name is not None
        sent = self.graph.actions.send_goal(
            self.client, action, type_name, goal, self.results.append, self.feedback.append
        )
        await settle()
        assert sent is not None
        return sent

    async def close(self) -> None:
        await self.queue.close(0.1)
