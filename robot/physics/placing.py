"""Places of bodies at the start: checked for overlaps, and drawn at random."""

import math
from dataclasses import replace

import numpy as np

from robot.description.model import RobotModel
from robot.errors import DescriptionError
from robot.physics.bodies import Body, Quaternion, SetBodies
from robot.physics.world import OVERLAP_M, World

DRAWN_WITHIN_M = 0.03  # along x and y

MAX_DRAWS = 100  # of one body: in a world that is full it stays in its place


def placed(robot: RobotModel, bodies: tuple[Body, ...], seed: int) -> tuple[Body, ...]:
    """Return the bodies, movable ones moved within :data:`DRAWN_WITHIN_M` and turned about z by chance; 0 for no draw.

    Raises DescriptionError for a body that cannot be simulated, and for bodies that overlap each other, the floor or
    the arm, whose joints are at 0.
    """
    joints = robot.movable_joints
    at_rad = np.array([min(max(0.0, joint.lower), joint.upper) for joint in joints])
    world = World(robot, [joint.name for joint in joints], at_rad)
    world.set_bodies(SetBodies(0, bodies))
    for body in bodies:
        if body.name not in world.bodies:
            raise DescriptionError(repr(body.name), "cannot be simulated")
    for first, second, depth_m in world.overlaps(world.bodies):
        limit = f"by {1e3 * depth_m:.0f} mm, more than {1e3 * OVERLAP_M:g} mm"
        raise DescriptionError(repr(first), f"overlaps {second!r} {limit}")
    if not seed:
        return bodies
    random = np.random.default_rng(seed)
    return tuple(_drawn(world, body, random) if body.movable else body for body in bodies)


def _drawn(world: World, body: Body, random: np.random.Generator) -> Body:
    """Return a body at a place where nothing is, its own if none is found."""
    x, y, z = body.position_m
    for _ in range(MAX_DRAWS):
        dx, dy = random.uniform(-DRAWN_WITHIN_M, DRAWN_WITHIN_M, 2).tolist()
        orientation = _turned(body.orientation, float(random.uniform(-math.pi, math.pi)))
        drawn = replace(body, position_m=(x + dx, y + dy, z), orientation=orientation)
        world.move(body.name, drawn.position_m, orientation)
        if not world.overlaps({body.name}):
            return drawn
    world.move(body.name, body.position_m, body.orientation)
    return body


def _turned(orientation: Quaternion, angle_rad: float) -> Quaternion:
    """Turn an orientation about the z axis of the root."""
    x, y, z, w = orientation
    s, c = math.sin(0.5 * angle_rad), math.cos(0.5 * angle_rad)
    return c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z
