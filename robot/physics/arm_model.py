"""MuJoCo's model of an arm, made from its URDF: links with masses and collision shapes, and joints with limits."""

import logging
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import mujoco

from robot.description.camera import Camera
from robot.description.meshes import with_mesh_paths
from robot.description.model import RobotModel
from robot.description.urdf import parsed
from robot.errors import DescriptionError

TIMESTEP_S = 0.002

# Density of links without a mass: printed parts with servos inside. The SO-101's masses over the volumes of its
# collision shapes are 330 to 910 kg/m^3.
LINK_DENSITY_KG_M3 = 600.0

# Inertia of the rotor behind the gear: 0.028 kg m^2 in MuJoCo Menagerie's model of the SO-101 (system identification of
# its STS3215). Links alone are too light for stable contacts at this time step.
ARMATURE_KG_M2 = 0.028

# A link without mass and without shapes, such as between two joints at one place [kg and kg m^2].
LEAST_MASS_KG, LEAST_INERTIA_KG_M2 = 1e-8, 1e-12

MESH_FORMATS = (".stl", ".obj", ".msh")  # formats that MuJoCo reads

# Grip needs friction across the finger, also about its normal: condim 4 has both.
CONTACT_DIMENSIONS = 4

# What stays where it is, as wood on wood: with the 1.0 of a rough object on it, a block on the floor jammed below the
# finger that pushed it towards the other.
FIXED_FRICTION = 0.5

# MuJoCo takes the friction of the shape with the higher priority: a slippery object's, else a fixed one's.
FIXED_PRIORITY = 2

# MuJoCo's advice against slip of gripped objects: elliptic cones, and friction much stiffer than the normal force.
FRICTION_STIFFNESS_RATIO = 10.0

log = logging.getLogger("armbridge.physics")


def arm_model(robot: RobotModel) -> mujoco.MjSpec:
    """Return the model of an arm on a floor, one body a link; raises DescriptionError for what cannot be read."""
    root = parsed(with_mesh_paths(robot.urdf, robot.mesh_directory, robot.package_directories))
    for mesh in root.iterfind("link/collision/geometry/mesh"):
        if (path := Path(mesh.get("filename", ""))).suffix.lower() not in MESH_FORMATS:
            raise DescriptionError(f"mesh {path}", f"cannot be loaded by physics, only {', '.join(MESH_FORMATS)}")
    compiler = ET.SubElement(ET.SubElement(root, "mujoco"), "compiler")
    switches = {"fusestatic": "false", "strippath": "false", "balanceinertia": "true"}
    least = {"boundmass": str(LEAST_MASS_KG), "boundinertia": str(LEAST_INERTIA_KG_M2)}
    compiler.attrib.update(switches | least)
    try:
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise DescriptionError("URDF", f"cannot be loaded by MuJoCo: {error}") from error
    _complete(spec, robot)
    return spec


def add_cameras(spec: mujoco.MjSpec, cameras: Mapping[str, Camera]) -> None:
    """Add cameras to links of a model, and light; the model is for images alone, without contacts."""
    for name, camera in cameras.items():
        body = spec.body(camera.frame)
        if body is None:
            raise DescriptionError(f"camera {name!r}", f"is on the link {camera.frame!r}, which the arm does not have")
        added = body.add_camera(name=name, pos=camera.view[:3], fovy=camera.field_of_view_deg)
        added.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        added.alt.xyaxes = camera.axes[:, :2].T.ravel().tolist()
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.visual.global_.offwidth = max(camera.width for camera in cameras.values())
    spec.visual.global_.offheight = max(camera.height for camera in cameras.values())
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.5] * 3, [0.7] * 3


def compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model; raises DescriptionError for what MuJoCo refuses, such as a damaged mesh."""
    try:
        return spec.compile()
    except ValueError as error:
        raise DescriptionError("URDF", f"cannot be loaded by MuJoCo: {' '.join(str(error).split())}") from error


def _complete(spec: mujoco.MjSpec, robot: RobotModel) -> None:
    """Add to a URDF's model the parts that a URDF does not have."""
    option = spec.option
    option.timestep = TIMESTEP_S
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = FRICTION_STIFFNESS_RATIO
    # A world that became unstable is reset by this package, with a fault.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    for joint in spec.joints:
        joint.armature = ARMATURE_KG_M2
    massless = []
    for body in spec.bodies:
        if body.name in robot.parts:
            # The planners' shapes: the URDF's boxes are larger, and would fill the space between the fingers.
            for geom in list(body.geoms):
                spec.delete(geom)
            for index, vertices in enumerate(robot.parts[body.name]):
                mesh = spec.add_mesh(name=f"{body.name} {index}", uservert=vertices.ravel().tolist())
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
        for geom in body.geoms:
            geom.condim = CONTACT_DIMENSIONS
            if not body.explicitinertial:
                geom.density = LINK_DENSITY_KG_M3
        if body.geoms and not body.explicitinertial:
            massless.append(body.name)
    if massless:
        _log_estimated(", ".join(massless))
    for first, second in robot.disabled_pairs:
        spec.add_exclude(bodyname1=first, bodyname2=second)
    for follower in robot.joints.values():
        if follower.mimic is not None:
            equality = spec.add_equality(name1=follower.name, name2=follower.mimic.joint)
            equality.type, equality.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
            equality.data[:2] = follower.mimic.offset, follower.mimic.multiplier
    # It does not touch the arm's base: MuJoCo lets no two bodies touch that are fixed in the world.
    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2.0, 2.0, 0.1])
    floor.friction[0], floor.priority, floor.condim = FIXED_FRICTION, FIXED_PRIORITY, CONTACT_DIMENSIONS


@cache
def _log_estimated(links: str) -> None:
    """Name links whose mass is estimated, once a process: a model is made at each try to open an arm."""
    estimate = f"estimated from the collision shapes at {LINK_DENSITY_KG_M3:g} kg/m^3"
    log.warning("physics: the URDF has no mass of %s; %s", links, estimate)


def gripper_links(robot: RobotModel) -> frozenset[str]:
    """Return the links between which the gripper holds objects."""
    joints = () if robot.gripper is None else (robot.joints[name] for name in robot.gripper.joints)
    return frozenset(link for joint in joints for link in (joint.parent, joint.child))
