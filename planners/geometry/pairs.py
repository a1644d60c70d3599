"""What there is to touch, and which two of it may not touch each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planners.geometry.shapes import link_name, scaled
from planners.geometry.world import placement, solid
from planners.scene import AttachedObject, Scene
from robot.description.model import RobotModel


@dataclass(frozen=True)
class Body:
    """One shape of a link or an object.

    Attributes:
        name: of the link or the object.
        shape: where it is and what carries it.
        is_link: whether it belongs to the robot itself.
        meets_links: whether it is checked against links.
        meets_objects: whether it is checked against objects.
        may_touch: names of links that it may touch.
        padding_m: how much thicker it is when it meets objects [m].
    """

    name: str
    shape: pin.GeometryObject
    is_link: bool
    meets_links: bool = True
    meets_objects: bool = True
    may_touch: frozenset[str] = frozenset()
    padding_m: float = 0.0


def links_of(model: pin.Model, shapes: Sequence[pin.GeometryObject], scene: Scene) -> list[Body]:
    """The robot's links as a scene wants them.

    Returns:
        One body for each shape; after them one for each scaled shape: only objects meet links in their other size.
    """
    bodies, larger = [], []
    for shape in shapes:
        name = link_name(model, shape)
        padding_m, factor = scene.link_padding_m.get(name, 0.0), scene.link_scale.get(name, 1.0)
        as_is = factor == 1.0
        bodies.append(Body(name, shape, is_link=True, meets_objects=as_is, padding_m=padding_m))
        if not as_is:
            resized = pin.GeometryObject(
                shape.name, shape.parentJoint, shape.parentFrame, shape.placement, scaled(shape.geometry, factor)
            )
            larger.append(Body(name, resized, is_link=True, meets_links=False, padding_m=padding_m))
    return [*bodies, *larger]


def held_by(model: pin.Model, attached: AttachedObject, reach_m: float) -> Iterator[Body]:
    """An object that moves with a link, which it touches.

    Args:
        model: the robot's joints.
        attached: the object.
        reach_m: points further than this from the robot can be left out of a plane [m].
    """
    frame_id = model.getFrameId(attached.link)
    frame = model.frames[frame_id]
    touched = attached.touch_links | {attached.link}
    at_link = frame.placement * placement(attached.object.pose)
    for shape, pose in attached.object.shapes:
        geometry, local = solid(shape, reach_m)
        place = at_link * placement(pose) * local
        carried = pin.GeometryObject(attached.object.name, frame.parentJoint, frame_id, place, geometry)
        yield Body(attached.object.name, carried, is_link=False, may_touch=touched)


def standing(scene: Scene, reach_m: float) -> Iterator[Body]:
    """What stands around the robot."""
    for thing in scene.objects:
        pose = placement(thing.pose)
        for shape, at in thing.shapes:
            place = pose * placement(at)
            geometry, local = solid(shape, reach_m + math.hypot(*place.translation))
            yield Body(thing.name, pin.GeometryObject(thing.name, 0, 0, place * local, geometry), is_link=False)


class Rules:
    """Which bodies are checked against each other.

    Those that do not move against each other are not, be they links of one joint or the root link and the world.

    Args:
        robot: neighbours and the pairs that its SRDF disables are not checked.
        allowed: pair of names -> whether it may touch, whatever the SRDF says.
    """

    def __init__(self, robot: RobotModel, allowed: Mapping[frozenset[str], bool]) -> None:
        adjacent = {frozenset((joint.parent, joint.child)) for joint in robot.joints.values()}
        self._unchecked = {names for names in adjacent | robot.disabled_pairs if allowed.get(names, True)}
        self._unchecked |= {names for names, may_touch in allowed.items() if may_touch}

    def pairs(self, movers: Sequence[Body], standing: Sequence[Body]) -> NDArray[np.int64]:
        """Indices in ``movers`` and then ``standing`` of bodies that are checked, shape (pairs, 2), smaller first."""
        bodies = [*movers, *standing]
        found = [
            (i, j)
            for i, first in enumerate(movers)
            for j, second in enumerate(bodies[i + 1 :], i + 1)
            if self._checked(first, second)
        ]
        return np.array(found, dtype=np.int64).reshape(-1, 2)

    def _checked(self, first: Body, second: Body) -> bool:
        return (
            first.shape.parentJoint != second.shape.parentJoint
            and (first.meets_links if second.is_link else first.meets_objects)
            and (second.meets_links if first.is_link else second.meets_objects)
            and first.name not in second.may_touch
            and second.name not in first.may_touch
            and frozenset((first.name, second.name)) not in self._unchecked
        )


def padding(bodies: Sequence[Body], pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """How far bodies of each pair must stay apart, shape (pairs,) [m]: links are padded against objects only."""
    thick_m = np.array([body.padding_m for body in bodies])
    link = np.array([body.is_link for body in bodies])
    first, second = pairs.T
    return np.where(link[first] != link[second], thick_m[first] + thick_m[second], 0.0)
