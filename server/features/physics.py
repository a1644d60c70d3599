"""Physics: the planning scene's objects are bodies around the simulated arm, and their poses come back as they move."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from planners.scene import Plane, Pose
from protocol.errors import MessageError
from robot.arm import Arm
from robot.errors import RobotError
from robot.messages import ArmState, PauseSimulation
from robot.physics.bodies import DEFAULT_FRICTION, MAX_BODIES, Body, BodyState, SetBodies
from server.errors import ConfigurationError, RefusedError
from server.features.context import ServerContext
from server.graph.node import Node
from server.graph.permissions import WORKING
from server.lifecycle import Feature
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import CollisionObject, read_bounded_pose
from server.moveit.scene.physical_bodies import body_of
from server.moveit.scene.planning_scene import SceneContents, SceneDraft
from server.moveit.scene.scene_state import SceneChange
from server.moveit.scene.worlds import body_refusal, read_world

# Ticks of one call of /simulation/step: ten seconds.
MAX_STEPS = 1000

# An arm process answers within a tick; a starved machine takes many times as long for its steps.
ANSWER_TIMEOUT_S, STEPS_TIMEOUT_S = 5.0, 60.0

UPDATE_S = 0.1  # interval of changes of the scene by objects that move

# Time without a finger on each side after which an attached object counts as dropped: longer once the gripper has
# another goal, since its client detaches the object then.
DROPPED_AFTER_S, RELEASED_AFTER_S = 0.5, 5.0

# Poses nearer than the reports of the arm process are the same.
SAME_M, SAME_QUATERNION = 2e-4, 1e-3

log = logging.getLogger("armbridge.physics")


def physics_of(context: ServerContext) -> list[Feature]:
    """Return the physics of a server whose arm has some."""
    physical = [name for name, arm in context.settings.arms.items() if arm.simulation == "physics"]
    if physical:
        raise ConfigurationError(f"arms.{physical[0]}.simulation: physics has one arm, without the section arms")
    arm = context.whole.served.arm
    if context.settings.arm.world is not None and context.settings.arm.simulation != "physics":
        raise ConfigurationError("arm.world: only an arm with physics has a world: set arm.simulation to physics")
    if context.settings.arm.simulation != "physics" or not isinstance(arm, Arm):
        return []
    return [Physics(context, arm)]


class Physics(Feature):
    """Bodies of the scene's objects; an attached object that is movable is a body between the gripper's fingers."""

    name = "physics"

    def __init__(self, context: ServerContext, arm: Arm) -> None:
        self._arm = arm
        self._scene = context.planning.scene_state
        self._current = context.planning.current
        # Of movable objects: mass [kg] and friction. Each names an object of the scene.
        self._movable: dict[str, tuple[float, float]] = {}
        self._bodies: dict[str, Body] = {}
        # Objects of the scene at the poses of their bodies, which need not be moved there.
        self._known: dict[str, CollisionObject] = {}
        self._states: dict[str, BodyState] = {}
        # Of each body: time by the arm's clock at which it was held last [s], and the gripper's goals then.
        self._held_at_s: dict[str, tuple[float, list[float]]] = {}
        gripper = context.whole.robot.gripper
        self._gripper_joints = () if gripper is None else gripper.joints
        self._version = 0
        self._updated_at_s = -math.inf
        self._state: ArmState | None = None
        self._stated = asyncio.Event()
        self._stepping = False
        # Contents of the world that was loaded, and its movable objects; None without one.
        self._world: tuple[SceneContents, dict[str, tuple[float, float]]] | None = None
        settings = context.settings.arm
        if settings.world is not None:
            self._open_world(settings.world, settings.world_seed, context)
        node, services = Node("simulation"), context.graph.services
        for name, type_name, serve in (
            ("set_body", "armbridge_msgs/srv/SetBody", self._set_body),
            ("set_pose", "armbridge_msgs/srv/SetBodyPose", self._set_pose),
            ("reset", "std_srvs/srv/Trigger", self._reset),
            ("pause", "std_srvs/srv/SetBool", self._pause),
            ("step", "armbridge_msgs/srv/StepSimulation", self._step),
        ):
            services.offer(node, f"/simulation/{name}", type_name, serve, rule=WORKING)
        self._scene.on_change(self._follow_scene)

    @property
    def body_states(self) -> Mapping[str, BodyState]:
        """Latest states of the movable bodies, by object."""
        return self._states

    async def start(self) -> None:
        """Send the objects of the run before."""
        self._follow_scene()

    def on_state(self, arm: str, state: ArmState) -> None:
        """Move objects of the scene to the poses of their bodies, and detach dropped ones."""
        if arm:
            return
        self._state = state
        self._stated.set()
        if state.bodies is not None and state.bodies.version == self._version:
            self._states.update({each.name: each for each in state.bodies.bodies})
        contents = self._scene.contents
        goals = {} if state.goal_rad is None else dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True))
        goal_rad = [goals[name] for name in self._gripper_joints if name in goals]
        for name, body in self._states.items():
            if body.held or name not in contents.attached or name not in self._held_at_s:
                self._held_at_s[name] = state.clock_s, goal_rad
        if _ticks(state) >= 0 or not 0.0 <= state.clock_s - self._updated_at_s < UPDATE_S:
            self._updated_at_s = state.clock_s
            self._update(state.clock_s, goal_rad)

    def _update(self, clock_s: float, goal_rad: list[float]) -> None:
        contents = self._scene.contents
        moved, dropped = {}, {}
        for name, state in self._states.items():
            pose = Pose(state.position_m, state.orientation)
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

    def _is_dropped(self, name: str, clock_s: float, goal_rad: list[float]) -> bool:
        held_at_s, held_with_rad = self._held_at_s[name]
        return clock_s - held_at_s > (DROPPED_AFTER_S if goal_rad == held_with_rad else RELEASED_AFTER_S)

    def _apply(self, objects: dict[str, CollisionObject], detached: tuple[str, ...]) -> None:
        def change(draft: SceneDraft) -> None:
            for name in detached:
                del draft.attached[name]
            draft.objects.update(objects)

        try:
            self._scene.apply(SceneChange(change, 0), self._current.positions_rad())
        except RefusedError as error:
            log.warning("objects of the physics cannot be moved in the scene: %s", error)

    def _follow_scene(self) -> None:
        """Send the bodies of the scene's objects where they have changed."""
        contents, bodies, known = self._scene.contents, {}, {}
        for name, held in contents.attached.items():
            if name in self._bodies and self._bodies[name].movable:
                bodies[name], known[name] = self._bodies[name], held.collision_object
        if (left_out := len(bodies) + len(contents.objects) - MAX_BODIES) > 0:
            log.warning("physics has %d objects at most: the last %d of the scene are left out", MAX_BODIES, left_out)
        for name, each in islice(contents.objects.items(), max(0, MAX_BODIES - len(bodies))):
            before = self._known.get(name)
            # A detached object is where the fingers left it, not where its link would have carried it.
            same = before is each or (before is not None and before.frame != each.frame)
            bodies[name] = self._bodies[name] if same else self._body_of(each)
            known[name] = each
        self._known = known
        for kept in (self._movable, self._held_at_s):
            for name in kept.keys() - known.keys():
                del kept[name]
        if bodies != self._bodies:
            self._send(bodies)

    def _send(self, bodies: dict[str, Body], placed: Mapping[str, Pose] | None = None) -> None:
        self._bodies, self._version = bodies, self._version + 1
        self._states = {}
        places = {name: (pose.position_m, pose.orientation) for name, pose in (placed or {}).items()}
        self._arm.simulate(SetBodies(self._version, tuple(bodies.values()), places))

    def _body_of(self, each: CollisionObject) -> Body:
        mass_kg, friction = self._movable.get(each.name, (0.0, DEFAULT_FRICTION))
        return replace(body_of(each), movable=each.name in self._movable, mass_kg=mass_kg, friction=friction)

    def _set_body(self, request: dict[str, Any]) -> Message:
        name = request["id"]
        each = self._scene.contents.objects.get(name)
        refusal = ""
        if each is None:
            refusal = f"there is no object {name!r} in the planning scene"
        elif name not in self._bodies:
            refusal = f"physics has {MAX_BODIES} objects at most, and {name!r} is left out"
        else:
            refusal = self._note_movable(request, each)
        if each is None or refusal:
            return {"success": False, "message": refusal}
        self._send({**self._bodies, name: self._body_of(each)})
        return {"success": True, "message": f"{name} {'can be moved' if request['movable'] else 'stays where it is'}"}

    def _note_movable(self, request: Message, each: CollisionObject) -> str:
        """Note mass and friction of an object; return the reason why it cannot be a body with them, or an empty one."""
        if refusal := body_refusal(request):
            return refusal
        self._movable.pop(each.name, None)
        if request["movable"]:
            if any(isinstance(shape, Plane) for shape, _ in each.shapes):
                return f"{each.name!r} has a plane, and cannot be movable"
            self._movable[each.name] = request["mass"], request["friction"] or DEFAULT_FRICTION
        return ""

    def _open_world(self, name: str, seed: int, context: ServerContext) -> None:
        """Begin with the world of a file, its movable objects at places drawn with a seed."""
        from robot.physics.placing import placed  # MuJoCo takes 200 ms

        try:
            scene, requests = read_world(name, context.graph.message_types)
            self._scene.apply_diff(scene, None)
            objects = self._scene.contents.objects
            refusals = (self._note_movable(request, objects[request["id"]]) for request in requests)
            refusal = next(filter(None, refusals), "")
            if len(objects) > MAX_BODIES:
                refusal = f"it has {len(objects)} objects, more than {MAX_BODIES}"
            wanted = tuple(map(self._body_of, objects.values()))
            bodies = () if refusal else placed(context.whole.robot, wanted, seed)
        except (OSError, ValueError, MessageError, RefusedError, RobotError) as error:
            raise ConfigurationError(f"arm.world: {name}: {error}") from error
        if refusal:
            raise ConfigurationError(f"arm.world: {name}: {refusal}")
        self._apply({each.name: replace(objects[each.name], pose=_pose(each)) for each in bodies}, ())
        self._world = self._scene.contents, dict(self._movable)

    def _reload_world(self, world: SceneContents, movable: Mapping[str, tuple[float, float]]) -> None:
        def change(draft: SceneDraft) -> None:
            draft.objects, draft.attached, draft.colors = dict(world.objects), {}, dict(world.colors)

        self._known, self._movable = {}, dict(movable)
        self._scene.apply(SceneChange(change, 0), self._current.positions_rad())
        self._follow_scene()

    def _reset(self, _request: dict[str, Any]) -> Message:
        if self._world is not None:
            self._reload_world(*self._world)
        movable = [body for body in self._bodies.values() if body.movable]
        self._place({body.name: _pose(body) for body in movable})
        return {"success": True, "message": f"{len(movable)} objects are where they were put"}

    def _set_pose(self, request: dict[str, Any]) -> Message:
        name = request["id"]
        if name not in self._bodies:
            refusal = f"the physics has no object {name!r}"
        elif not self._bodies[name].movable:
            refusal = f"{name!r} stays where it is: move it in the planning scene, or make it movable first"
        else:
            try:
                self._place({name: read_bounded_pose(request["pose"], "pose")})
            except RefusedError as error:
                refusal = str(error)
            else:
                return {"success": True, "message": f"{name} is put there"}
        return {"success": False, "message": refusal}

    def _place(self, poses: Mapping[str, Pose]) -> None:
        """Put movable bodies at poses now, out of the fingers too."""
        contents, moved = self._scene.contents, {}
        for name, pose in poses.items():
            held = contents.attached[name].collision_object if name in contents.attached else contents.objects[name]
            moved[name] = replace(held, frame=self._scene.frame, pose=pose)
        self._known.update(moved)
        self._apply(moved, tuple(name for name in moved if name in contents.attached))
        self._send(self._bodies, poses)

    async def _pause(self, request: dict[str, Any]) -> Message:
        paused = request["data"]
        # Steps in progress are a pause already, and are not cut short.
        if not (paused and self._stepping):
            self._arm.simulate(PauseSimulation(paused))
        if not await self._reaches(lambda state: (_ticks(state) >= 0) == paused, ANSWER_TIMEOUT_S):
            return {"success": False, "message": f"the arm process did not answer within {ANSWER_TIMEOUT_S:g} s"}
        return {"success": True, "message": f"the time of the simulation {'stands still' if paused else 'passes'}"}

    async def _step(self, request: dict[str, Any]) -> Message:
        steps, before, refusal = request["steps"], _ticks(self._state), ""
        if not 1 <= steps <= MAX_STEPS:
            refusal = f"steps must be 1 to {MAX_STEPS}, not {steps}"
        elif before < 0:
            refusal = "the time of the simulation passes: call /simulation/pause with true first"
        elif self._stepping:
            refusal = "other steps are in progress"
        if refusal:
            return {"success": False, "message": refusal}
        self._stepping = True
        try:
            self._arm.simulate(PauseSimulation(paused=True, ticks=steps))
            wanted = before + steps
            # The end of the pause is the end of the steps.
            await self._reaches(lambda state: _ticks(state) < 0 or _ticks(state) >= wanted, STEPS_TIMEOUT_S)
        finally:
            self._stepping = False
        done = max(_ticks(self._state) - before, 0)
        return {"success": done == steps, "message": f"{done} of {steps} steps are done"}

    async def _reaches(self, reached: Callable[[ArmState], bool], timeout_s: float) -> bool:
        """Wait for a state of the arm; return False when none comes within a time."""
        try:
            async with asyncio.timeout(timeout_s):
                while self._state is None or not reached(self._state):
                    self._stated.clear()
                    await self._stated.wait()
        except TimeoutError:
            return False
        return True


def _pose(body: Body) -> Pose:
    return Pose(body.position_m, body.orientation)


def _ticks(state: ArmState | None) -> int:
    """Return the single ticks since the time stands still; -1 while it passes."""
    return -1 if state is None or state.stepped_ticks is None else state.stepped_ticks


def _differ(first: Pose, second: Pose) -> bool:
    way_m = np.abs(np.subtract(first.position_m, second.position_m)).max()
    turned = np.abs(np.subtract(first.orientation, second.orientation)).max()
    return bool(way_m > SAME_M or turned > SAME_QUATERNION)
