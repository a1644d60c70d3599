"""``/save_geometry_to_file`` and ``/load_geometry_from_file``."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Shape, Sphere
from protocol.errors import MessageError
from server.errors import RefusedError
from server.graph import Graph
from server.moveit.current_state import CurrentState
from server.moveit.requests.error_codes import invalid, required
from server.moveit.scene import shapes
from server.moveit.scene.collision_objects import ADD, NO_STAMP, Thing
from server.moveit.scene.planning_scene import SceneContents
from server.moveit.scene.scene_state import SceneState
from server.node import Node

Message = Mapping[str, Any]

# What MoveIt writes for a thing without colour.
NO_COLOR = "0 0 0 0"

END = "."
THING = "* "


def write_geometry(contents: SceneContents) -> str:
    """The text of what stands around; prisms become meshes, which is what the format has."""
    lines = [contents.name]
    for thing in contents.objects.values():
        color = contents.colors.get(thing.name)
        lines += _thing_lines(thing, NO_COLOR if color is None else _figures(color[part] for part in "rgba"))
    return "\n".join([*lines, END, ""])


def read_geometry(text: str, frame: str) -> list[dict[str, Any]]:
    """The things of a text, as moveit_msgs/CollisionObject that add them.

    Args:
        text: as :func:`write_geometry` or MoveIt writes it.
        frame: the planning frame.

    Raises:
        RefusedError: a line that is not as it must be, named by its number.
    """
    lines = _Lines(text)
    lines.next("the scene's name")
    objects = []
    while (line := lines.next(f"a thing or {END!r}")) != END:
        if not line.startswith(THING):
            raise lines.wrong(f"{THING + 'ID'!r} or {END!r}")
        objects.append(_read_thing(lines, line.removeprefix(THING).strip(), frame))
    return objects


def _thing_lines(thing: Thing, color: str) -> Iterator[str]:
    yield THING + thing.name
    yield from _pose_lines(thing.pose)
    yield str(len(thing.shapes))
    for shape, pose in thing.shapes:
        yield from _shape_lines(shape)
        yield from _pose_lines(pose)
        yield color
    yield str(len(thing.subframes))
    for name, pose in thing.subframes.items():
        yield name
        yield from _pose_lines(pose)


def _pose_lines(pose: Pose) -> Iterator[str]:
    yield _figures(pose.position_m)
    yield _figures(pose.orientation)


def _shape_lines(shape: Shape) -> list[str]:
    match shape:
        case Box(size_m):
            return ["box", _figures(size_m)]
        case Sphere(radius_m):
            return ["sphere", _figures([radius_m])]
        case Cylinder(radius_m, height_m):
            return ["cylinder", _figures([radius_m, height_m])]
        case Cone(radius_m, height_m):
            return ["cone", _figures([radius_m, height_m])]
        case Plane(normal, offset_m):
            return ["plane", _figures([*normal, -offset_m])]
        case Mesh(vertices_m, triangles):
            counts = f"{len(vertices_m)} {len(triangles)}"
            corners = [" ".join(map(str, triangle)) for triangle in triangles.tolist()]
            return ["mesh", counts, *(_figures(vertex) for vertex in vertices_m.tolist()), *corners]


def _figures(values: Any) -> str:
    # repr gives every digit that matters and no more.
    return " ".join(repr(float(value)) for value in values)


class _Lines:
    """The lines of a text, one after the other."""

    def __init__(self, text: str) -> None:
        self._lines = text.splitlines()
        self._number = 0

    def peek(self) -> str:
        """The next line, which stays the next; empty at the end."""
        return self._lines[self._number] if self._number < len(self._lines) else ""

    def next(self, wanted: str) -> str:
        """The next line; the argument says what should be there."""
        if self._number >= len(self._lines):
            raise invalid(f"the file ends after line {self._number}, where {wanted} should be")
        self._number += 1
        return self._lines[self._number - 1].strip()

    def wrong(self, wanted: str) -> Exception:
        """A refusal of the last line, to be raised."""
        return invalid(f"line {self._number} must be {wanted}, not {self._lines[self._number - 1][:40]!r}")

    def figures(self, count: int, wanted: str) -> list[float]:
        """The next line as so many numbers."""
        words = self.next(wanted).split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise self.wrong(wanted) from None
        if len(values) != count:
            raise self.wrong(wanted)
        return values

    def counts(self, count: int, wanted: str) -> list[int]:
        """The next line as so many whole numbers from 0 on."""
        values = self.figures(count, wanted)
        # What is counted follows line by line, so there cannot be more of it than lines.
        if not all(value.is_integer() and 0 <= value <= len(self._lines) for value in values):
            raise self.wrong(wanted)
        return [int(value) for value in values]


def _read_thing(lines: _Lines, name: str, frame: str) -> dict[str, Any]:
    has_pose = len(lines.peek().split()) > 1
    pose = _read_pose(lines) if has_pose else _pose_message([0.0] * 3, [0.0, 0.0, 0.0, 1.0])
    told: dict[str, list[Any]] = {"primitives": [], "meshes": [], "planes": []}
    poses: dict[str, list[Any]] = {"primitives": [], "meshes": [], "planes": []}
    (count,) = lines.counts(1, "the number of shapes")
    for _ in range(count):
        kind = lines.next("a kind of shape")
        if kind not in _READERS:
            raise lines.wrong(f"one of {', '.join(_READERS)}")
        field, read = _READERS[kind]
        told[field].append(read(lines))
        poses[field].append(_read_pose(lines))
        lines.figures(4, "a colour r g b a")
    subframes = dict(
        _read_subframe(lines) for _ in range(lines.counts(1, "the number of subframes")[0] if has_pose else 0)
    )
    return {
        "header": {"stamp": NO_STAMP, "frame_id": frame},
        "id": name,
        "pose": pose,
        **told,
        "primitive_poses": poses["primitives"],
        "mesh_poses": poses["meshes"],
        "plane_poses": poses["planes"],
        "subframe_names": list(subframes),
        "subframe_poses": list(subframes.values()),
        "operation": ADD,
    }


def _read_pose(lines: _Lines) -> dict[str, Any]:
    return _pose_message(lines.figures(3, "a position x y z"), lines.figures(4, "a quaternion x y z w"))


def _pose_message(position: list[float], quaternion: list[float]) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }


def _read_subframe(lines: _Lines) -> tuple[str, dict[str, Any]]:
    return lines.next("a subframe's name"), _read_pose(lines)


def _read_mesh(lines: _Lines) -> Message:
    vertices, triangles = lines.counts(2, "the numbers of vertices and triangles")
    corners = [lines.figures(3, "a vertex x y z") for _ in range(vertices)]
    return {
        "vertices": [dict(zip("xyz", corner, strict=True)) for corner in corners],
        "triangles": [{"vertex_indices": lines.counts(3, "a triangle's vertices")} for _ in range(triangles)],
    }


def _read_round(kind: int, lines: _Lines) -> Message:
    radius_m, height_m = lines.figures(2, "radius and length")
    return {"type": kind, "dimensions": [height_m, radius_m]}


_READERS: Mapping[str, tuple[str, Callable[[_Lines], Message]]] = {
    "box": ("primitives", lambda lines: {"type": shapes.BOX, "dimensions": lines.figures(3, "a box's edges")}),
    "sphere": ("primitives", lambda lines: {"type": shapes.SPHERE, "dimensions": lines.figures(1, "a radius")}),
    "cylinder": ("primitives", lambda lines: _read_round(shapes.CYLINDER, lines)),
    "cone": ("primitives", lambda lines: _read_round(shapes.CONE, lines)),
    "plane": ("planes", lambda lines: {"coef": lines.figures(4, "a plane a b c d")}),
    "mesh": ("meshes", _read_mesh),
}


log = logging.getLogger("armbridge.scene")


SAVE = "/save_geometry_to_file"
LOAD = "/load_geometry_from_file"

# A mesh of a hundred thousand triangles, with its vertices, has as much text.
MAX_FILE_BYTES = 10_000_000


class GeometryFiles:
    """Saves and loads what stands around.

    Args:
        graph: where the services are.
        node: who offers them.
        state: the scene.
        directory: where the files are; None for nowhere.
    """

    def __init__(self, graph: Graph, node: Node, state: SceneState, directory: Path | None) -> None:
        self._graph = graph
        self._node = node
        self._state = state
        self._directory = directory

    def open(self, current: CurrentState) -> None:
        """Offer the services.

        Args:
            current: where the joints are.
        """

        async def save(request: Message) -> Message:
            return await _told(SAVE, self._save(request["file_path_and_name"]))

        async def load(request: Message) -> Message:
            return await _told(LOAD, self._load(request["file_path_and_name"], current))

        services = self._graph.services
        services.offer(self._node, SAVE, "moveit_msgs/srv/SaveGeometryToFile", save)
        services.offer(self._node, LOAD, "moveit_msgs/srv/LoadGeometryFromFile", load)

    async def _save(self, name: str) -> None:
        path = file_within(self._directory, name)
        try:
            await asyncio.to_thread(_write_bounded, path, self._state.contents)
        except OSError as error:
            raise invalid(f"{path} cannot be written: {error}") from error

    async def _load(self, name: str, current: CurrentState) -> None:
        path = file_within(self._directory, name)
        try:
            objects = await asyncio.to_thread(_read_bounded, path, self._state.frame)
        except (OSError, UnicodeDecodeError) as error:
            raise invalid(f"{path} cannot be read: {error}") from error
        try:
            complete = self._graph.interfaces.complete
            world = complete("moveit_msgs/msg/PlanningSceneWorld", {"collision_objects": objects})
        except MessageError as error:
            raise invalid(f"{path}: {error}") from error
        # As in MoveIt, what the file does not name stays.
        required(self._state.apply_diff({"is_diff": True, "world": world}, current.positions_rad()))


def file_within(directory: Path | None, name: str) -> Path:
    """The file that a client means; relative names start in the directory.

    Args:
        directory: where files may be; None for nowhere.
        name: as the client gave it.

    Raises:
        RefusedError: it is elsewhere, or no file of any name.
    """
    if directory is None:
        raise invalid("the setting moveit.geometry_directory names no folder, so there are no files")
    folder = directory.resolve()
    try:
        path = (folder / name).resolve()
    except (ValueError, OSError) as error:
        raise invalid(f"file_path_and_name {name[:100]!r} is no file: {error}") from error
    if path == folder or not path.is_relative_to(folder):
        raise invalid(f"file_path_and_name {name[:100]!r} must be a file in {folder}")
    return path


async def _told(service: str, work: Any) -> Message:
    """Do it, and tell the log why it could not be done."""
    try:
        await work
    except RefusedError as error:
        log.warning("%s: %s", service, error)
        return {"success": False}
    return {"success": True}


def _write_bounded(path: Path, contents: SceneContents) -> None:
    text = write_geometry(contents)
    if len(text) > MAX_FILE_BYTES:
        raise invalid(f"the scene has {len(text)} characters as text, more than {MAX_FILE_BYTES}")
    path.write_text(text)


def _read_bounded(path: Path, frame: str) -> list[dict[str, Any]]:
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise invalid(f"{path} has {size} bytes, more than {MAX_FILE_BYTES}")
    return read_geometry(path.read_text(), frame)
