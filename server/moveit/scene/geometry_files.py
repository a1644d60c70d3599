"""Files of a scene's geometry: MoveIt's ``.scene`` format, and the services that save and load it.

In the format of planning_scene's ``saveGeometryToStream``, the scene's name is followed by the objects. Each has a line
``* ID``, its pose (a line of position [m], one of the quaternion x y z w), the number of its shapes, each with kind,
figures, pose and colour, and the number of its subframes, each with name and pose. A line with a dot ends the file.
Files of older versions have neither the objects' poses nor subframes.
"""

import logging
from collections.abc import Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from planners.scene import Box, Cone, Cylinder, Mesh, Plane, Pose, Shape, Sphere
from protocol.errors import MessageError
from robot import files
from server.disk import Disk
from server.errors import RefusedError, UnsuccessfulError, invalid
from server.execution.monitors import CurrentState
from server.graph.permissions import CONFIGURING, WORKING, Rule
from server.graph.topics import LocalNode
from server.moveit.messages import Message, write_pose
from server.moveit.scene import collision_objects as shapes
from server.moveit.scene.collision_objects import ADD, IDENTITY, NO_STAMP, CollisionObject
from server.moveit.scene.planning_scene import SceneContents
from server.moveit.scene.scene_state import SceneState

log = logging.getLogger("armbridge.scene")

SAVE = "/save_geometry_to_file"
LOAD = "/load_geometry_from_file"

# A mesh of a hundred thousand triangles, with its vertices, has as much text.
MAX_FILE_BYTES = 10_000_000

# MoveIt's colour for objects without one.
NO_COLOR = "0 0 0 0"

END = "."
OBJECT = "* "


def write_geometry(contents: SceneContents) -> str:
    """Write the collision objects of a scene; prisms become meshes, because the format has no prisms."""
    lines = [contents.name]
    for each in contents.objects.values():
        color = contents.colors.get(each.name)
        lines += _object_lines(each, NO_COLOR if color is None else _figures(color[part] for part in "rgba"))
    return "\n".join([*lines, END, ""])


def read_geometry(text: str, frame: str) -> list[dict[str, Any]]:
    """Read the objects of a text, as moveit_msgs/CollisionObject that add them."""
    lines = _Lines(text)
    lines.next("the scene's name")
    objects = []
    while (line := lines.next(f"an object or {END!r}")) != END:
        if not line.startswith(OBJECT):
            raise lines.wrong(f"{OBJECT + 'ID'!r} or {END!r}")
        objects.append(_read_object(lines, line.removeprefix(OBJECT).strip(), frame))
    return objects


def _object_lines(collision_object: CollisionObject, color: str) -> Iterator[str]:
    yield OBJECT + collision_object.name
    yield from _pose_lines(collision_object.pose)
    yield str(len(collision_object.shapes))
    for shape, pose in collision_object.shapes:
        yield from _shape_lines(shape)
        yield from _pose_lines(pose)
        yield color
    yield str(len(collision_object.subframes))
    for name, pose in collision_object.subframes.items():
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
    # repr has as many digits as a float needs to be read back exactly.
    return " ".join(repr(float(value)) for value in values)


class _Lines:
    def __init__(self, text: str) -> None:
        self._lines = text.splitlines()
        self._number = 0

    def peek(self) -> str:
        """Return the next line without consuming it; empty at the end."""
        return self._lines[self._number] if self._number < len(self._lines) else ""

    def next(self, expected: str) -> str:
        """Consume the next line; the argument describes it for errors."""
        if self._number >= len(self._lines):
            raise invalid(f"the file ends after line {self._number}, where {expected} should be")
        self._number += 1
        return self._lines[self._number - 1].strip()

    def wrong(self, expected: str) -> Exception:
        return invalid(f"line {self._number} must be {expected}, not {self._lines[self._number - 1][:40]!r}")

    def figures(self, count: int, expected: str) -> list[float]:
        """Consume the next line as ``count`` numbers."""
        words = self.next(expected).split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise self.wrong(expected) from None
        if len(values) != count:
            raise self.wrong(expected)
        return values

    def counts(self, count: int, expected: str) -> list[int]:
        """Consume the next line as ``count`` whole numbers from 0 on."""
        values = self.figures(count, expected)
        # Each counted item has at least a line, so a greater count is an error, found before memory is allocated.
        if not all(value.is_integer() and 0 <= value <= len(self._lines) for value in values):
            raise self.wrong(expected)
        return [int(value) for value in values]


def _read_object(lines: _Lines, name: str, frame: str) -> dict[str, Any]:
    has_pose = len(lines.peek().split()) > 1
    pose = _read_pose(lines) if has_pose else write_pose(IDENTITY)
    poses_of = {field: poses for field, poses, _ in shapes.GEOMETRY_KINDS}
    geometry: dict[str, list[Any]] = {key: [] for keys in poses_of.items() for key in keys}
    (count,) = lines.counts(1, "the number of shapes")
    for _ in range(count):
        kind = lines.next("a kind of shape")
        if kind not in _READERS:
            raise lines.wrong(f"one of {', '.join(_READERS)}")
        field, read = _READERS[kind]
        geometry[field].append(read(lines))
        geometry[poses_of[field]].append(_read_pose(lines))
        lines.figures(4, "a colour r g b a")
    subframes = {}
    for _ in range(lines.counts(1, "the number of subframes")[0] if has_pose else 0):
        subframe = lines.next("a subframe's name")
        subframes[subframe] = _read_pose(lines)
    return {
        "header": {"stamp": NO_STAMP, "frame_id": frame},
        "id": name,
        "pose": pose,
        **geometry,
        "subframe_names": list(subframes),
        "subframe_poses": list(subframes.values()),
        "operation": ADD,
    }


def _read_pose(lines: _Lines) -> dict[str, Any]:
    position, quaternion = lines.figures(3, "a position x y z"), lines.figures(4, "a quaternion x y z w")
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }


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


def offer_geometry_files(node: LocalNode, state: SceneState, current: CurrentState, directory: Path | None) -> None:
    disk = Disk()

    async def save(name: str) -> None:
        contents = state.contents
        try:
            await disk.do(lambda: _write_bounded(file_within(directory, name), contents))
        except OSError as error:
            raise invalid(f"{name} cannot be written: {error}") from error

    def read_world(name: str) -> Message:
        path = file_within(directory, name)
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise invalid(f"{path} has {size} bytes, more than {MAX_FILE_BYTES}")
        objects = {"collision_objects": read_geometry(path.read_text(), state.frame)}
        return node.message_types.complete("moveit_msgs/msg/PlanningSceneWorld", objects)

    async def load(name: str) -> None:
        try:
            world = await disk.do(lambda: read_world(name))
        except (OSError, UnicodeDecodeError) as error:
            raise invalid(f"{name} cannot be read: {error}") from error
        except MessageError as error:
            raise invalid(f"{name}: {error}") from error
        # As in MoveIt, objects that the file does not name stay.
        await state.submit(state.diff({"is_diff": True, "world": world}), current.positions_rad())

    def offer(service: str, type_name: str, work: Callable[[str], Awaitable[None]], rule: Rule) -> None:
        async def serve(request: Message) -> Message:
            try:
                await work(request["file_path_and_name"])
            except RefusedError as error:
                # The response has no field for the reason.
                log.warning("%s: %s", service, error)
                raise UnsuccessfulError({"success": False}, str(error)) from error
            return {"success": True}

        node.offer(service, f"moveit_msgs/srv/{type_name}", serve, rule=rule)

    offer(SAVE, "SaveGeometryToFile", save, CONFIGURING)
    offer(LOAD, "LoadGeometryFromFile", load, WORKING)


def file_within(directory: Path | None, name: str) -> Path:
    """Return the path of a client's file; relative names start in the directory."""
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


def _write_bounded(path: Path, contents: SceneContents) -> None:
    text = write_geometry(contents)
    if len(text) > MAX_FILE_BYTES:
        raise invalid(f"the scene has {len(text)} characters as text, more than {MAX_FILE_BYTES}")
    with files.locked(path):
        files.replace(path, text.encode())
