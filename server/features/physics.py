"""Physics: the planning scene's objects are bodies around the simulated arm, and their poses come back as they move."""

import asyncio
import functools
import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Shape, Sphere
from protocol.errors import MessageError
from robot.arm import Arm
from robot.errors import RobotError
from robot.messages import ArmState, Mode, PauseSimulation
from robot.physics.bodies import DEFAULT_FRICTION, MAX_BODIES, MAX_HULL_CORNERS, Body, BodyShape, BodyState, SetBodies
from robot.trajectory import Vector
from server.config import NamedArmSettings
from server.errors import ConfigurationError, RefusedError, ServerError, ServiceError
from server.features.context import ArmContext, ServerContext
from server.graph.message_types import MessageTypes
from server.graph.permissions import WORKING
from server.lifecycle import Feature
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import IDENTITY, CollisionObject, read_bounded_pose
from server.moveit.scene.frames import in_root, seen_from
from server.moveit.scene.planning_scene import SceneContents, SceneDraft
from server.moveit.scene.saved_scene import MAX_SCENE_BYTES, complete_scene
from server.named_files import SUFFIX, read_json

# Ticks of one call of /simulation/step: ten seconds.
MAX_STEPS = 1000

# An arm process answers within a tick; a starved machine takes many times as long for its steps.
ANSWER_TIMEOUT_S, STEPS_TIMEOUT_S = 5.0, 60.0

UPDATE_S = 0.1  # interval of changes of the scene by objects that move

# Time without a finger on each side after which an attached object counts as dropped: longer once the gripper has
# another goal, since its client detaches the object then.
DROPPED_AFTER_S, RELEASED_AFTER_S = 0.5, 5.0

SET_BODY_TYPE = "armbridge_msgs/srv/SetBody"

# Poses nearer than the reports of the arm process are the same.
SAME_M, SAME_QUATERNION = 2e-4, 1e-3

log = logging.getLogger("armbridge.physics")


def physics_of(context: ServerContext) -> list[Feature]:
    """Return the physics of a server whose simulated arms have some."""
    if context.settings.simulation.kind != "physics":
        return []
    simulated = [each for each in context.single_arms if each[0].served.settings.serial is None]
    return [Physics(context, [ArmWorld(*each) for each in simulated])]


class ArmWorld:
    """World of one arm, in its process: there the bodies of this arm move, and all others stay where they are."""

    def __init__(self, arm: ArmContext, handle: Arm) -> None:
        settings, robot = arm.served.settings, arm.robot
        self.name, self.graph, self.arm = arm.name, arm.graph, handle
        self.links = frozenset(robot.links)
        self.gripper_joints = () if robot.gripper is None else robot.gripper.joints
        self.version = 0
        self.state: ArmState | None = None
        self._root = IDENTITY  # pose of its root link in the frame of the scene
        if isinstance(settings, NamedArmSettings):
            roll, pitch, yaw = settings.base_rpy_rad
            if roll or pitch:
                raise ConfigurationError(
                    f"arms.{arm.name}.base_rpy_rad: physics needs an upright arm, with roll and pitch 0, not "
                    f"{roll:g} and {pitch:g} rad"
                )
            self._root = Pose(settings.base_xyz_m, (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)))

    def send(self, bodies: Iterable[Body], placed: Mapping[str, Pose]) -> None:
        """Send bodies, and the poses at which movable bodies are put, all in the frame of the scene."""
        self.version += 1
        moved = tuple(_at(body, seen_from(self._root, _pose(body))) for body in bodies)
        places = {name: seen_from(self._root, pose) for name, pose in placed.items()}
        put = {name: (pose.position_m, pose.orientation) for name, pose in places.items()}
        self.arm.simulate(SetBodies(self.version, moved, put))

    def reported(self) -> list[BodyState]:
        """Return the bodies that have moved by the latest state, in the frame of the scene."""
        if self.state is None or self.state.bodies is None or self.state.bodies.version != self.version:
            return []
        return [_at(each, in_root(self._root, _pose(each))) for each in self.state.bodies.bodies]

    @property
    def gripper_goal_rad(self) -> list[float]:
        if self.state is None or self.state.goal_rad is None:
            return []
        goals = dict(zip(self.state.joint_names, self.state.goal_rad.tolist(), strict=True))
        return [goals[name] for name in self.gripper_joints if name in goals]

    @property
    def ticks(self) -> int:
        """Single ticks since its time stands still; -1 while it passes."""
        return -1 if self.state is None or self.state.stepped_ticks is None else self.state.stepped_ticks

    def distance_m(self, pose: Pose) -> float:
        return math.dist(self._root.position_m, pose.position_m)


@dataclass(frozen=True)
class _Movable:
    """Movable object of the scene: its mass [kg], its friction, and the arm in whose world it moves."""

    mass_kg: float
    friction: float
    mover: str


class Physics(Feature):
    """Bodies of the scene's objects; an attached object that is movable is a body between the gripper's fingers.

    Each arm has a world of its own. A movable object moves in the world of one arm, which is the arm that holds it or
    has held it last; for the other arms it stays where it is.
    """

    name = "physics"

    def __init__(self, context: ServerContext, worlds: Sequence[ArmWorld]) -> None:
        self._worlds = {each.name: each for each in worlds}
        self._scene = context.planning.scene_state
        self._current = context.planning.current
        self._movable: dict[str, _Movable] = {}  # by object of the scene
        # Bodies at the poses where a client put them, and the objects that have moved since at their latest ones.
        self._bodies: dict[str, Body] = {}
        self.body_states: dict[str, BodyState] = {}  # the latest of the movable bodies, by object
        # Objects of the scene at the poses of their bodies, which need not be moved there.
        self._known: dict[str, CollisionObject] = {}
        # By object: time of the arm's clock at which it was held last [s], and the gripper's goals then.
        self._held_at_s: dict[str, tuple[float, list[float]]] = {}
        self._updated_at_s: dict[str, float] = {}  # by arm
        self._stated = asyncio.Event()
        self._paused = self._stepping = False
        # Contents of the world that was loaded, and its movable objects; None without one.
        self._world: tuple[SceneContents, dict[str, _Movable]] | None = None
        settings = context.settings.simulation
        # A client and the scene live in the machine's time.
        self._update_s, self._released_after_s = UPDATE_S * settings.rate, RELEASED_AFTER_S * settings.rate
        if settings.world is not None:
            self._open_world(settings.world, settings.world_seed, context)
        node = context.graph.node("simulation")
        for name, type_name, serve in (
            ("set_body", SET_BODY_TYPE, self._set_body),
            ("set_pose", "armbridge_msgs/srv/SetBodyPose", self._set_pose),
            ("reset", "std_srvs/srv/Trigger", self._reset),
            ("pause", "std_srvs/srv/SetBool", self._pause),
            ("step", "armbridge_msgs/srv/StepSimulation", self._step),
        ):
            node.offer(f"/simulation/{name}", type_name, serve, rule=WORKING)
        for each in worlds:
            if each.name:
                set_body = functools.partial(self._set_body, mover=each.name)
                each.graph.node("simulation").offer("/simulation/set_body", SET_BODY_TYPE, set_body, rule=WORKING)
        self._scene.on_change(self._follow_scene)

    async def start(self) -> None:
        """Send the objects of the run before."""
        self._follow_scene()

    def on_state(self, arm: str, state: ArmState) -> None:
        """Move objects of the scene to the poses of their bodies, and detach dropped ones."""
        world = self._worlds.get(arm)
        if world is None:
            return
        world.state = state
        self._stated.set()
        # A process that was started again lets its time pass, which the check of its servos takes.
        if self._paused and not self._stepping and world.ticks < 0 and state.mode is not Mode.DISCONNECTED:
            world.arm.simulate(PauseSimulation(paused=True))
        own = {each.name: each for each in world.reported() if self._mover(each.name) == arm}
        self.body_states.update(own)
        attached, goal_rad = self._scene.contents.attached, world.gripper_goal_rad
        for name, body in self.body_states.items():
            if self._mover(name) == arm and (body.held or name not in attached or name not in self._held_at_s):
                self._held_at_s[name] = state.clock_s, goal_rad
        if world.ticks >= 0 or not 0.0 <= state.clock_s - self._updated_at_s.get(arm, -math.inf) < self._update_s:
            self._updated_at_s[arm] = state.clock_s
            self._update(world, state.clock_s)

    def _mover(self, name: str) -> str | None:
        return self._movable[name].mover if name in self._movable else None

    def _update(self, world: ArmWorld, clock_s: float) -> None:
        contents, goal_rad = self._scene.contents, world.gripper_goal_rad
        moved, dropped = {}, {}
        for name, state in self.body_states.items():
            if self._mover(name) != world.name:
                continue
            pose = _pose(state)
            if name in contents.objects and _differ(contents.objects[name].pose, pose):
                moved[name] = replace(contents.objects[name], pose=pose)
            elif name in contents.attached and self._is_dropped(name, clock_s, goal_rad):
                held = contents.attached[name].collision_object
                dropped[name] = replace(held, frame=self._scene.frame, pose=pose)
                x, y, z = state.position_m
                log.warning("the gripper does not hold %r: it is at x %.3f, y %.3f, z %.3f m", name, x, y, z)
        if moved or dropped:
            self._known.update(moved | dropped)
            self._apply(moved | dropped, tuple(dropped))
            for other in self._worlds.values():
                if other is not world:
                    self._send_to(other, {})

    def _is_dropped(self, name: str, clock_s: float, goal_rad: list[float]) -> bool:
        held_at_s, held_with_rad = self._held_at_s[name]
        return clock_s - held_at_s > (DROPPED_AFTER_S if goal_rad == held_with_rad else self._released_after_s)

    def _apply(self, objects: dict[str, CollisionObject], detached: tuple[str, ...]) -> None:
        def change(draft: SceneDraft) -> None:
            for name in detached:
                del draft.attached[name]
            draft.objects.update(objects)

        try:
            self._scene.apply(change, self._current.positions_rad())
        except RefusedError as error:
            log.warning("objects of the physics cannot be moved in the scene: %s", error)

    def _follow_scene(self) -> None:
        """Send the bodies of the scene's objects where they have changed."""
        contents, bodies, known, put = self._scene.contents, {}, {}, {}
        for name, held in contents.attached.items():
            if name in self._bodies and self._bodies[name].movable:
                bodies[name], known[name] = self._bodies[name], held.collision_object
        if (left_out := len(bodies) + len(contents.objects) - MAX_BODIES) > 0:
            log.warning("physics has %d objects at most: the last %d of the scene are left out", MAX_BODIES, left_out)
        for name, present in islice(contents.objects.items(), max(0, MAX_BODIES - len(bodies))):
            before = self._known.get(name)
            # A detached object is where the fingers left it, not where its link would have carried it.
            same = before is present or (before is not None and before.frame != present.frame)
            bodies[name] = self._bodies[name] if same else self._body_of(present)
            # Its body may have moved since, also if the object is put where it was put before.
            if not same and name in self.body_states:
                put[name] = present.pose
            known[name] = present
        self._known = known
        for kept in (self._movable, self._held_at_s):
            for name in kept.keys() - known.keys():
                del kept[name]
        if put or bodies != self._bodies:
            self._send(bodies, put)
        for name, held in contents.attached.items():
            holder = next((each.name for each in self._worlds.values() if held.link in each.links), None)
            if holder is not None and name in self._movable:
                self._move_by(name, holder)

    def _move_by(self, name: str, mover: str) -> None:
        """Have a movable object move in the world of an arm, from where it is."""
        if self._movable[name].mover != mover:
            state, self._movable[name] = self.body_states.get(name), replace(self._movable[name], mover=mover)
            self._held_at_s.pop(name, None)
            for world in self._worlds.values():
                self._send_to(world, {} if state is None else {name: _pose(state)})

    def _send(self, bodies: dict[str, Body], placed: Mapping[str, Pose]) -> None:
        changed = {name for name in self.body_states if bodies.get(name) != self._bodies.get(name)} | placed.keys()
        self.body_states = {name: state for name, state in self.body_states.items() if name not in changed}
        self._bodies = bodies
        for world in self._worlds.values():
            self._send_to(world, placed)

    def _send_to(self, world: ArmWorld, placed: Mapping[str, Pose]) -> None:
        """Send a world its movable bodies, and the others' as they are by now."""
        own = {name for name in self._bodies if self._mover(name) == world.name}
        present = {name: _pose(state) for name, state in self.body_states.items()} | dict(placed)
        world.send(
            (
                body if name in own else replace(_at(body, present.get(name, _pose(body))), movable=False)
                for name, body in self._bodies.items()
            ),
            {name: pose for name, pose in placed.items() if name in own},
        )

    def _body_of(self, collision_object: CollisionObject) -> Body:
        movable, fixed = self._movable.get(collision_object.name), body_of(collision_object)
        if movable is None:
            return fixed
        return replace(fixed, movable=True, mass_kg=movable.mass_kg, friction=movable.friction)

    def _set_body(self, request: dict[str, Any], mover: str | None = None) -> str:
        name = request["id"]
        collision_object = self._scene.contents.objects.get(name)
        if collision_object is None:
            raise ServiceError(f"there is no object {name!r} in the planning scene")
        if name not in self._bodies:
            raise ServiceError(f"physics has {MAX_BODIES} objects at most, and {name!r} is left out")
        self._note_movable(request, collision_object, mover)
        self._send({**self._bodies, name: self._body_of(collision_object)}, {})
        return f"{name} {'can be moved' if request['movable'] else 'stays where it is'}"

    def _note_movable(self, request: Message, collision_object: CollisionObject, mover: str | None = None) -> None:
        """Note figures of a body, whose mover is the nearest arm for None; raises ServiceError for wrong figures."""
        if refusal := body_refusal(request):
            raise ServiceError(refusal)
        name = collision_object.name
        self._movable.pop(name, None)
        if request["movable"]:
            if any(isinstance(shape, Plane) for shape, _ in collision_object.shapes):
                raise ServiceError(f"{name!r} has a plane, and cannot be movable")
            if mover is None:
                mover = min(self._worlds.values(), key=lambda world: world.distance_m(collision_object.pose)).name
            self._movable[name] = _Movable(request["mass"], request["friction"] or DEFAULT_FRICTION, mover)

    def _open_world(self, name: str, seed: int, context: ServerContext) -> None:
        """Begin with the world of a file, its movable objects at places drawn with a seed."""
        from robot.physics.placing import placed  # MuJoCo takes 200 ms

        try:
            scene, requests = read_world(name, context.graph.message_types)
            self._scene.apply_diff(scene, None)
            objects = self._scene.contents.objects
            if len(objects) > MAX_BODIES:
                raise ServiceError(f"it has {len(objects)} objects, more than {MAX_BODIES}")
            for request in requests:
                self._note_movable(request, objects[request["id"]])
            bodies = placed(context.whole.robot, tuple(map(self._body_of, objects.values())), seed)
        except (OSError, ValueError, MessageError, ServerError, RobotError) as error:
            raise ConfigurationError(f"simulation.world: {name}: {error}") from error
        self._apply({each.name: replace(objects[each.name], pose=_pose(each)) for each in bodies}, ())
        self._world = self._scene.contents, dict(self._movable)

    def _reload_world(self, world: SceneContents, movable: Mapping[str, _Movable]) -> None:
        def change(draft: SceneDraft) -> None:
            draft.objects, draft.attached, draft.colors = dict(world.objects), {}, dict(world.colors)

        self._known, self._movable = {}, dict(movable)
        self._scene.apply(change, self._current.positions_rad())
        self._follow_scene()

    def _reset(self, _request: dict[str, Any]) -> str:
        if self._world is not None:
            self._reload_world(*self._world)
        movable = [body for body in self._bodies.values() if body.movable]
        self._place({body.name: _pose(body) for body in movable})
        return f"put back: {', '.join(body.name for body in movable) or 'nothing'}"

    def _set_pose(self, request: dict[str, Any]) -> str:
        name = request["id"]
        if name not in self._bodies:
            raise ServiceError(f"the physics has no object {name!r}")
        if not self._bodies[name].movable:
            raise ServiceError(f"{name!r} stays where it is: move it in the planning scene, or make it movable first")
        self._place({name: read_bounded_pose(request["pose"], "pose")})
        return f"{name} is put there"

    def _place(self, poses: Mapping[str, Pose]) -> None:
        """Put movable bodies at poses now, out of the fingers too."""
        contents, moved = self._scene.contents, {}
        for name, pose in poses.items():
            held = contents.attached[name].collision_object if name in contents.attached else contents.objects[name]
            moved[name] = replace(held, frame=self._scene.frame, pose=pose)
        self._known.update(moved)
        self._apply(moved, tuple(name for name in moved if name in contents.attached))
        self._send(self._bodies, poses)

    async def _pause(self, request: dict[str, Any]) -> str:
        paused, self._paused = request["data"], False
        # Steps in progress are a pause already, and are not cut short.
        if not (paused and self._stepping):
            self._simulate(PauseSimulation(paused))
        if not await self._reach(lambda world: (world.ticks >= 0) == paused, ANSWER_TIMEOUT_S):
            # The time of one arm must not stand still alone: another's process may be starting again.
            self._simulate(PauseSimulation(paused=False))
            raise ServiceError(f"the arm process did not answer within {ANSWER_TIMEOUT_S:g} s")
        self._paused = paused
        return f"the time of the simulation {'stands still' if paused else 'passes'}"

    async def _step(self, request: dict[str, Any]) -> str:
        steps = request["steps"]
        before = {name: world.ticks for name, world in self._worlds.items()}
        if not 1 <= steps <= MAX_STEPS:
            raise ServiceError(f"steps must be 1 to {MAX_STEPS}, not {steps}")
        if min(before.values()) < 0:
            raise ServiceError("the time of the simulation passes: call /simulation/pause with true first")
        if self._stepping:
            raise ServiceError("other steps are in progress")
        self._stepping = True
        try:
            self._simulate(PauseSimulation(paused=True, ticks=steps))
            # The end of the pause is the end of the steps.
            await self._reach(lambda world: not 0 <= world.ticks < before[world.name] + steps, STEPS_TIMEOUT_S)
        finally:
            self._stepping = False
        done = max(min(world.ticks - before[name] for name, world in self._worlds.items()), 0)
        if done < steps:
            raise ServiceError(f"{done} of {steps} steps are done")
        return f"{done} of {steps} steps are done"

    def _simulate(self, command: PauseSimulation) -> None:
        for world in self._worlds.values():
            world.arm.simulate(command)

    async def _reach(self, reached: Callable[[ArmWorld], bool], timeout_s: float) -> bool:
        """Wait for states of all arms; return False when they do not come within a time."""
        try:
            async with asyncio.timeout(timeout_s):
                while not all(world.state is not None and reached(world) for world in self._worlds.values()):
                    self._stated.clear()
                    await self._stated.wait()
        except TimeoutError:
            return False
        return True


Posed = TypeVar("Posed", Body, BodyState)


def _pose(body: Body | BodyState) -> Pose:
    return Pose(body.position_m, body.orientation)


def _at(body: Posed, pose: Pose) -> Posed:
    return replace(body, position_m=pose.position_m, orientation=pose.orientation)


def _differ(first: Pose, second: Pose) -> bool:
    distance_m = np.abs(np.subtract(first.position_m, second.position_m)).max()
    turned = np.abs(np.subtract(first.orientation, second.orientation)).max()
    return bool(distance_m > SAME_M or turned > SAME_QUATERNION)


CONE_SIDES = 24  # of the prism that stands for a cone


def body_of(collision_object: CollisionObject) -> Body:
    """Return the fixed body of an object at its pose."""
    shapes, pose = tuple(_body_shape(*shape) for shape in collision_object.shapes), collision_object.pose
    return Body(collision_object.name, shapes, pose.position_m, pose.orientation)


def _body_shape(shape: Shape, pose: Pose) -> BodyShape:
    """Return the shape of a body; a mesh has its convex hull, and a cone is a pyramid of many sides."""
    at = pose.position_m, pose.orientation
    match shape:
        case Box(size_m):
            return BodyShape("box", tuple(0.5 * edge for edge in size_m), *at)
        case Sphere(radius_m):
            return BodyShape("sphere", (radius_m,), *at)
        case Cylinder(radius_m, height_m):
            return BodyShape("cylinder", (radius_m, 0.5 * height_m), *at)
        case Plane(normal, offset_m):
            return BodyShape("plane", (), *_plane_pose(pose, normal, offset_m))
        case Cone(radius_m, height_m):
            angles = np.linspace(0.0, math.tau, CONE_SIDES, endpoint=False).tolist()
            foot = [(radius_m * math.cos(each), radius_m * math.sin(each), -0.5 * height_m) for each in angles]
            return BodyShape("hull", (), *at, ((0.0, 0.0, 0.5 * height_m), *foot))
        case Mesh():
            corners = _outermost(shape.vertices_m).tolist()
            return BodyShape("hull", (), *at, tuple((x, y, z) for x, y, z in corners))


def _outermost(points_m: Vector) -> Vector:
    """Return corners of the convex hull of points, shape (n, 3) [m]: of many, the outermost in many directions."""
    points = np.unique(points_m, axis=0)
    if len(points) <= MAX_HULL_CORNERS:
        return points
    # Directions on a Fibonacci sphere, which cover it evenly.
    index = np.arange(MAX_HULL_CORNERS) + 0.5
    z, turn = 1.0 - 2.0 * index / MAX_HULL_CORNERS, math.pi * (1.0 + math.sqrt(5.0)) * index
    level = np.sqrt(1.0 - z * z)
    directions = np.column_stack((level * np.cos(turn), level * np.sin(turn), z))
    outermost: Vector = points[np.unique(np.argmax(points @ directions.T, axis=0))]
    return outermost


def _plane_pose(pose: Pose, normal: tuple[float, float, float], offset_m: float) -> tuple[Any, Any]:
    """Return position and orientation of a plane whose z axis is the normal: the shortest turn from z to it."""
    x, y, z = normal
    length = math.hypot(1.0 + z, x, y)
    turn = (-y / length, x / length, 0.0, (1.0 + z) / length) if z > -1.0 + 1e-9 else (1.0, 0.0, 0.0, 0.0)
    at = in_root(pose, Pose((offset_m * x, offset_m * y, offset_m * z), turn))
    return at.position_m, at.orientation


FOLDER = Path(__file__).parents[1] / "worlds"  # of the worlds that come with the program

MAX_MASS_KG = 100.0
MAX_FRICTION = 10.0


def read_world(name: str, message_types: MessageTypes) -> tuple[Message, Sequence[Message]]:
    """Read a world by its name or path: its moveit_msgs/PlanningScene, and a request of SetBody for each of its bodies.

    Raises OSError, ValueError or MessageError.
    """
    known = sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}"))
    path = FOLDER / f"{name}{SUFFIX}" if name in known else Path(name).expanduser()
    if not path.is_file():
        raise ValueError(f"there is no such file; the built-in worlds are {', '.join(known)}")
    content = read_json(path, MAX_SCENE_BYTES)
    bodies = content.pop("bodies", []) if isinstance(content, dict) else []
    scene = complete_scene(message_types, content)
    listed = bodies if isinstance(bodies, list) else [bodies]
    requests = [message_types.complete("armbridge_msgs/srv/SetBody_Request", each) for each in listed]
    names = {each["id"] for each in scene["world"]["collision_objects"]}
    for index, request in enumerate(requests):
        if request["id"] not in names:
            raise ValueError(f"bodies[{index}].id: there is no object {request['id']!r} in the scene")
        if refusal := body_refusal(request):
            raise ValueError(f"bodies[{index}].{refusal}")
    return scene, requests


def body_refusal(request: Message) -> str:
    """Return the reason why no body has these figures of a request of SetBody; empty for none."""
    mass_kg, friction = request["mass"], request["friction"]
    if not 0.0 <= mass_kg <= MAX_MASS_KG:
        return f"mass must be 0 to {MAX_MASS_KG:g} kg, 0 for a mass by its volume, not {mass_kg:g}"
    if not 0.0 <= friction <= MAX_FRICTION:
        return f"friction must be 0 to {MAX_FRICTION:g}, 0 for {DEFAULT_FRICTION:g}, not {friction:g}"
    return ""
