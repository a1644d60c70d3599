"""Simulated world of one arm: its links and the bodies around them, in MuJoCo's time steps."""

import logging
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace

import mujoco
import numpy as np

from robot.description.camera import Camera
from robot.description.model import RobotModel
from robot.emulator.plant import MAX_STEP_S
from robot.errors import DescriptionError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.physics.arm_model import (
    CONTACT_DIMENSIONS,
    FIXED_FRICTION,
    FIXED_PRIORITY,
    TIMESTEP_S,
    add_cameras,
    arm_model,
    compiled,
    gripper_links,
)
from robot.physics.bodies import Body, BodyShape, BodyState, BodyStates, Point, Quaternion, SetBodies
from robot.trajectory import Vector

BODY_DENSITY_KG_M3 = 500.0  # dry wood

# A change of pose that is reported: less than a servo's tick at the tip of the SO-101.
MOVED_M = 5e-4
MOVED_QUATERNION = 2e-3  # of one of its components, about 0.2 deg

OVERLAP_M = 0.002  # contacts of resting bodies are some tenths of a millimetre deep

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "plane": mujoco.mjtGeom.mjGEOM_PLANE,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}

log = logging.getLogger("armbridge.physics")


class World:
    """World in which the torques of an arm's joints move its links, and these move other bodies.

    Arrays have shape (joints,), in the order of ``joint_names``: positions [rad or m], torques [Nm or N].
    """

    def __init__(
        self,
        robot: RobotModel,
        joint_names: Sequence[str],
        position_rad: Vector,
        cameras: Mapping[str, Camera] | None = None,
    ) -> None:
        # MuJoCo writes a log file into the working directory otherwise.
        mujoco.set_mju_user_warning(lambda text: log.debug("MuJoCo: %s", text))
        self._spec = arm_model(robot)
        if cameras:
            add_cameras(self._spec, cameras)
        self._fingers = gripper_links(robot)
        self.model = compiled(self._spec)
        self.data = mujoco.MjData(self.model)
        # A joint of one degree of freedom has one index in positions and in velocities; the arm comes first in both.
        self._joints = np.array([self.model.joint(name).id for name in joint_names])
        # Largest torques by the URDF; an effort of 0 stands for none given.
        effort_nm = self.model.jnt_actfrcrange[self._joints, 1]
        self.effort_nm = np.where(effort_nm > 0.0, effort_nm, np.inf)
        self._due_s = 0.0
        self._bodies: dict[str, Body] = {}
        self._version = 0
        self._reported: dict[str, BodyState] = {}
        self._overlaps: Set[tuple[str, str]] = frozenset()  # pairs that are known, which are logged once
        self.place(position_rad)

    @property
    def position_rad(self) -> Vector:
        return self._of_joints(self.data.qpos)

    @property
    def velocity_rad_s(self) -> Vector:
        """Velocities of the joints [rad/s or m/s]."""
        return self._of_joints(self.data.qvel)

    @property
    def load_nm(self) -> Vector:
        """Torques that gravity and motion ask of the joints at their positions."""
        return self._of_joints(self.data.qfrc_bias)

    def torque_for(self, acceleration: Vector) -> Vector:
        """Compute the torques that accelerate the joints [rad/s^2 or m/s^2], without the load."""
        full = np.zeros(self.model.nv)
        full[self._joints] = acceleration
        torque_nm = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, torque_nm, full)
        return self._of_joints(torque_nm)

    def _of_joints(self, values: Vector) -> Vector:
        selected: Vector = values[self._joints]
        return selected

    def place(self, position_rad: Vector) -> None:
        """Move the joints to positions at once, at rest."""
        self.data.qpos[self._joints] = position_rad
        self.data.qvel[self._joints] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def limit(self, lower_rad: Vector, upper_rad: Vector) -> None:
        """Set the mechanical stops of the joints."""
        self.model.jnt_range[self._joints] = np.column_stack((lower_rad, upper_rad))
        self.model.jnt_limited[self._joints] = True

    def push(self, torque_nm: Vector, damping_nm_s: Vector) -> None:
        """Set the torques of the joints, and their viscous damping [Nm s/rad], for the steps to come."""
        self.data.qfrc_applied[self._joints] = torque_nm
        self.model.dof_damping[self._joints] = damping_nm_s

    def drag(self, joint: int, velocity_rad_s: float) -> None:
        """Give the joint at an index a velocity, as a hand does that is stronger than its motor."""
        self.data.qvel[self._joints[joint]] = velocity_rad_s

    def advance(self, duration_s: float, drive: Callable[[], None]) -> None:
        """Advance by a time [s] in steps of :data:`TIMESTEP_S`; ``drive`` sets the torques before each step.

        Raises PortLost for a world that has become unstable; it is at its last finite positions then, at rest.
        """
        self._due_s += min(duration_s, MAX_STEP_S)
        before = self.data.qpos.copy()
        # Half a step less: rounding must not leave one of five for the next tick.
        while self._due_s > 0.5 * TIMESTEP_S:
            self._due_s -= TIMESTEP_S
            drive()
            mujoco.mj_step(self.model, self.data)
            # A velocity that is not finite has made its position so in the same step.
            if not np.isfinite(self.data.qpos).all():
                fixed = self.data.mocap_pos.copy(), self.data.mocap_quat.copy()
                mujoco.mj_resetData(self.model, self.data)
                self.data.qpos[:] = before
                self.data.mocap_pos[:], self.data.mocap_quat[:] = fixed
                mujoco.mj_forward(self.model, self.data)
                raise PortLost(EmulatedConfig.port, "the physics had no finite positions, and was reset")

    def set_bodies(self, command: SetBodies) -> None:
        """Have the bodies of a command in the world; bodies that overlap others, or cannot be simulated, are logged."""
        before, wanted = self._bodies, {body.name: body for body in command.bodies}
        states = {state.name: state for state in self._states()}
        put = {name: (body.position_m, body.orientation) for name, body in wanted.items() if before.get(name) != body}
        put |= command.placed
        placed = set(put)
        kinds = [{name: _kind(body) for name, body in bodies.items()} for bodies in (before, wanted)]
        if kinds[0] != kinds[1]:
            wanted = self._rebuild(wanted)
            stayed = {name: (body.position_m, body.orientation) for name, body in wanted.items()}
            put = stayed | {name: (state.position_m, state.orientation) for name, state in states.items()} | put
        self._bodies, self._version, self._reported = wanted, command.version, {}
        for name, pose in put.items():
            if name in wanted:
                self._put(name, *pose)
        mujoco.mj_forward(self.model, self.data)
        overlaps = {(name, other): depth_m for name, other, depth_m in self.overlaps(placed & wanted.keys())}
        for pair in overlaps.keys() - self._overlaps:
            log.warning("physics: %r overlaps %r by %.0f mm; they push each other apart", *pair, 1e3 * overlaps[pair])
        self._overlaps = overlaps.keys()

    def moved_bodies(self, *, every: bool) -> BodyStates | None:
        """Return the movable bodies that have moved since they were returned last, or every one; None for none."""
        moved = [state for state in self._states() if every or _differ(self._reported.get(state.name), state)]
        self._reported.update({state.name: state for state in moved})
        return BodyStates(self._version, tuple(moved)) if moved else None

    def _states(self) -> list[BodyState]:
        movable = [name for name, body in self._bodies.items() if body.movable]
        if not movable:
            return []
        touching = self._touching()
        states = []
        for name in movable:
            held = len(touching.get(_in_model(name), set()) & self._fingers) > 1
            states.append(BodyState(name, *self.pose(_in_model(name)), held))
        return states

    def color(self, colors: Mapping[str, Sequence[float]]) -> None:
        """Set the colours of bodies by name: red, green, blue, alpha."""
        for name in colors.keys() & self._bodies.keys():
            self.model.geom_rgba[self.model.geom_bodyid == self.model.body(_in_model(name)).id] = colors[name]

    def pose(self, name: str) -> tuple[Point, Quaternion]:
        """Return position [m] and orientation of a link, or of a body by its name in the model."""
        at = self.model.body(name).id
        x, y, z = self.data.xpos[at].tolist()
        qw, qx, qy, qz = self.data.xquat[at].tolist()
        return (x, y, z), (qx, qy, qz, qw)

    def _touching(self) -> dict[str, set[str]]:
        """Return the names of the bodies and links in contact with each body."""
        touching: dict[str, set[str]] = {}
        for first, second, _ in self._contacts():
            touching.setdefault(first, set()).add(second)
            touching.setdefault(second, set()).add(first)
        return touching

    def _contacts(self) -> list[tuple[str, str, float]]:
        """Return the names of the bodies in each contact, and its depth [m]."""
        bodies = self.model.geom_bodyid[np.reshape(self.data.contact.geom, (-1, 2))].tolist()
        # The world's own body has the floor alone.
        names = [[self.model.body(at).name if at else "floor" for at in pair] for pair in bodies]
        return [(pair[0], pair[1], -depth) for pair, depth in zip(names, self.data.contact.dist.tolist(), strict=True)]

    @property
    def bodies(self) -> Set[str]:
        """Names of the bodies in the world: those that cannot be simulated are left out."""
        return self._bodies.keys()

    def move(self, name: str, position_m: Point, orientation: Quaternion) -> None:
        """Put a body somewhere at once, at rest."""
        self._put(name, position_m, orientation)
        mujoco.mj_forward(self.model, self.data)

    def overlaps(self, placed: Set[str]) -> list[tuple[str, str, float]]:
        """Return each pair with one of these bodies that overlaps by more than :data:`OVERLAP_M`, and the depth [m]."""
        deepest: dict[frozenset[str], float] = {}
        for first, second, depth_m in self._contacts():
            if depth_m > OVERLAP_M and {_outside(first), _outside(second)} & placed:
                pair = frozenset((_outside(first), _outside(second)))
                deepest[pair] = max(depth_m, deepest.get(pair, 0.0))
        return [(*sorted(pair), depth_m) for pair, depth_m in deepest.items() if len(pair) == 2]  # type: ignore[misc]

    def _put(self, name: str, position_m: Sequence[float], orientation: Sequence[float]) -> None:
        x, y, z, w = orientation
        body = self.model.body(_in_model(name))
        if not self._bodies[name].movable:
            self.data.mocap_pos[body.mocapid[0]], self.data.mocap_quat[body.mocapid[0]] = position_m, (w, x, y, z)
            return
        at, dof = self.model.jnt_qposadr[body.jntadr[0]], body.dofadr[0]
        self.data.qpos[at : at + 7] = (*position_m, w, x, y, z)
        self.data.qvel[dof : dof + 6] = 0.0

    def _rebuild(self, wanted: dict[str, Body]) -> dict[str, Body]:
        """Compile the model with other bodies, the arm where it is; return the bodies that can be simulated."""
        position_rad, velocity_rad_s = self.position_rad, self.velocity_rad_s
        stops_rad = self.model.jnt_range[self._joints]
        before = {name: _kind(body) for name, body in self._bodies.items()}
        added = [name for name, body in wanted.items() if before.get(name) != _kind(body)]
        for name in before:
            if name in added or name not in wanted:
                self._remove(name)
        for name in added:
            self._add(wanted[name])
        try:
            model = compiled(self._spec)
        except DescriptionError as error:
            log.warning("physics: %s cannot be simulated, and are left out: %s", ", ".join(map(repr, added)), error)
            for name in added:
                self._remove(name)
            model = compiled(self._spec)
            wanted = {name: body for name, body in wanted.items() if name not in added}
        self.model, self.data = model, mujoco.MjData(model)
        self.limit(*stops_rad.T)
        self.place(position_rad)
        self.data.qvel[self._joints] = velocity_rad_s
        return wanted

    def _remove(self, name: str) -> None:
        body = self._spec.body(_in_model(name))
        if body is not None:
            self._spec.delete(body)

    def _add(self, body: Body) -> None:
        element = self._spec.worldbody.add_body(name=_in_model(body.name))
        if body.movable:
            element.add_freejoint()
        else:
            element.mocap = True  # it is put elsewhere without compiling the model again
        for index, shape in enumerate(body.shapes):
            x, y, z, w = shape.orientation
            geom = element.add_geom(
                type=_KINDS[shape.kind],
                size=_size(shape),
                pos=shape.position_m,
                quat=[w, x, y, z],
                condim=CONTACT_DIMENSIONS,
                density=BODY_DENSITY_KG_M3,
            )
            geom.friction[0], geom.priority = FIXED_FRICTION, FIXED_PRIORITY
            if body.movable:
                geom.friction[0] = body.friction
                geom.priority += 1 if body.friction < FIXED_FRICTION else -1
            if shape.kind == "hull":
                vertices = np.array(shape.vertices_m).ravel().tolist()
                geom.meshname = self._spec.add_mesh(name=f"{_in_model(body.name)} {index}", uservert=vertices).name
        if body.movable and body.mass_kg > 0.0:
            for geom in element.geoms:
                geom.mass = body.mass_kg / len(element.geoms)


def _size(shape: BodyShape) -> list[float]:
    return [*shape.size_m, *[0.0] * (3 - len(shape.size_m))] if shape.kind != "plane" else [2.0, 2.0, 0.1]


def _kind(body: Body) -> Body:
    """Return all that the compiled model has of a body, whose pose is in the state."""
    return replace(body, position_m=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 0.0, 1.0))


def _differ(before: BodyState | None, now: BodyState) -> bool:
    if before is None or before.held != now.held:
        return True
    turned = np.abs(np.subtract(before.orientation, now.orientation)).max()
    return bool(np.abs(np.subtract(before.position_m, now.position_m)).max() > MOVED_M or turned > MOVED_QUATERNION)


_PREFIX = "object/"  # objects may have the names of links


def _in_model(name: str) -> str:
    return _PREFIX + name


def _outside(name: str) -> str:
    return name.removeprefix(_PREFIX)
