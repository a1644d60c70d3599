"""Physics: the planning scene's objects are bodies around the simulated arm, and their poses come back as they move."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from planners.scene import Plane, Pose
from robot.arm import Arm
from robot.messages import ArmState
from robot.physics.bodies import DEFAULT_FRICTION, MAX_BODIES, Body, BodyState, SetBodies
from server.errors import ConfigurationError, RefusedError
from server.features.context import ServerContext
from server.graph.node import Node
from server.graph.permissions import WORKING
from server.lifecycle import Feature
from server.moveit.messages import Message
from server.moveit.scene.collision_objects import CollisionObject
from server.moveit.scene.physical_bodies import body_of
from server.moveit.scene.planning_scene import SceneDraft
from server.moveit.scene.scene_state import SceneChange

SET_BODY, SET_BODY_TYPE = "/simulation/set_body", "armbridge_msgs/srv/SetBody"
RESET = "/simulation/reset"

UPDATE_S = 0.1  # interval of changes of the scene by objects that move

# Time without a finger on each side after which an attached object counts as dropped: longer once the gripper has
# another goal, since its client detaches the object then.
DROPPED_AFTER_S, RELEASED_AFTER_S = 0.5, 5.0

# Poses nearer than the reports of the arm process are the same.
SAME_M, SAME_QUATERNION = 2e-4, 1e-3

MAX_MASS_KG = 100.0
MAX_FRICTION = 10.0

log = logging.getLogger("armbridge.physics")


def physics_of(context: ServerContext) -> list[Feature]:
    """Return the physics of a server whose arm has some."""
    physical = [name for name, arm in context.settings.arms.items() if arm.simulation == "physics"]
    if physical:
        raise ConfigurationError(f"arms.{physical[0]}.simulation: physics has one arm, without the section arms")
    arm = context.whole.served.arm
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
        node = Node("simulation")
        graph = context.graph
        graph.services.offer(node, SET_BODY, SET_BODY_TYPE, self._set_body, rule=WORKING)
        graph.services.offer(node, RESET, "std_srvs/srv/Trigger", self._reset, rule=WORKING)
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
        if state.bodies is not None and state.bodies.version == self._version:
            self._states.update({each.name: each for each in state.bodies.bodies})
        contents = self._scene.contents
        goals = {} if state.goal_rad is None else dict(zip(state.joint_names, state.goal_rad.tolist(), strict=True))
        goal_rad = [goals[name] for name in self._gripper_joints if name in goals]
        for name, body in self._states.items():
            if body.held or name not in contents.attached or name not in self._held_at_s:
                self._held_at_s[name] = state.clock_s, goal_rad
        if not 0.0 <= state.clock_s - self._updated_at_s < UPDATE_S:
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

    def _send(self, bodies: dict[str, Body], *, reset: bool = False) -> None:
        self._bodies, self._version = bodies, self._version + 1
        self._states = {}
        self._arm.set_bodies(SetBodies(self._version, tuple(bodies.values()), reset))

    def _body_of(self, each: CollisionObject) -> Body:
        mass_kg, friction = self._movable.get(each.name, (0.0, DEFAULT_FRICTION))
        return replace(body_of(each), movable=each.name in self._movable, mass_kg=mass_kg, friction=friction)

    def _set_body(self, request: dict[str, Any]) -> Message:
        name, mass_kg, friction = request["id"], request["mass"], request["friction"]
        each = self._scene.contents.objects.get(name)
        refusal = ""
        if each is None:
            refusal = f"there is no object {name!r} in the planning scene"
        elif name not in self._bodies:
            refusal = f"physics has {MAX_BODIES} objects at most, and {name!r} is left out"
        elif not 0.0 <= mass_kg <= MAX_MASS_KG:
            refusal = f"mass must be 0 to {MAX_MASS_KG:g} kg, 0 for a mass by its volume, not {mass_kg:g}"
        elif not 0.0 <= friction <= MAX_FRICTION:
            refusal = f"friction must be 0 to {MAX_FRICTION:g}, 0 for {DEFAULT_FRICTION:g}, not {friction:g}"
        elif request["movable"] and any(isinstance(shape, Plane) for shape, _ in each.shapes):
            refusal = f"{name!r} has a plane, and cannot be movable"
        if each is None or refusal:
            return {"success": False, "message": refusal}
        self._movable.pop(name, None)
        if request["movable"]:
            self._movable[name] = mass_kg, friction or DEFAULT_FRICTION
        self._send({**self._bodies, name: self._body_of(each)})
        return {"success": True, "message": f"{name} {'can be moved' if request['movable'] else 'stays where it is'}"}

    def _reset(self, _request: dict[str, Any]) -> Message:
        contents, moved = self._scene.contents, {}
        for name, body in self._bodies.items():
            if body.movable:
                held = contents.attached[name].collision_object if name in contents.attached else contents.objects[name]
                pose = Pose(body.position_m, body.orientation)
                moved[name] = replace(held, frame=self._scene.frame, pose=pose)
        self._known.update(moved)
        self._apply(moved, tuple(name for name in moved if name in contents.attached))
        self._send(self._bodies, reset=True)
        return {"success": True, "message": f"{len(moved)} objects are where they were put"}


def _differ(first: Pose, second: Pose) -> bool:
    way_m = np.abs(np.subtract(first.position_m, second.position_m)).max()
    turned = np.abs(np.subtract(first.orientation, second.orientation)).max()
    return bool(way_m > SAME_M or turned > SAME_QUATERNION)
