"""Folder of an arm: ``robot.toml`` and the files that it names, read into the robot's model and its table of servos.

The package example-robot-data brings the descriptions of some fifty published robots, which are found by their names.
"""

import json
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import robot.arms
from robot.description import model, robot_file
from robot.description.camera import Camera
from robot.description.meshes import surface_file
from robot.description.model import GripperModel, Hull, JointLimits, LinkSurface, RobotModel
from robot.description.robot_file import HardwareSection, RobotFile, ServoTable
from robot.description.servo_table import MAX_HOMING_OFFSET, HardwareTable, ServoSpec, Zero, ZeroTick
from robot.errors import DescriptionError, RobotFileError

PACKAGE = "example-robot-data"

# Where the package keeps its descriptions; their meshes are named package://example-robot-data/robots/...
_SHARE = f"cmeel.prefix/share/{PACKAGE}"

_ENDINGS = ("", "_robot", "_reduced")  # endings that a file may have beyond the robot's name, the plainest first


@dataclass(frozen=True)
class ExampleRobot:
    """Files of a published robot."""

    urdf: Path
    srdf: Path
    packages: tuple[Path, ...]  # folders for `package://`


def find_example(name: str) -> ExampleRobot | None:
    """Find a robot in the installed package example-robot-data; None without the package, or for an unknown name."""
    robots = _robots()
    if robots is None or name not in _urdfs(robots):
        return None
    urdf = _urdfs(robots)[name]
    srdf = urdf.parents[1] / "srdf" / f"{name}.srdf"
    if not srdf.is_file():
        remedy = f"armbridge robot import {urdf} --package-path {robots.parents[1]} makes a folder with one"
        raise DescriptionError(f"{PACKAGE}'s robot {name!r}", f"has no SRDF ({srdf} is not there): {remedy}")
    return ExampleRobot(urdf, srdf, (robots.parents[1],))


def _robots() -> Path | None:
    try:
        folder = Path(str(metadata.distribution(PACKAGE).locate_file(_SHARE))) / "robots"
    except metadata.PackageNotFoundError:
        return None
    return folder if folder.is_dir() else None


def _urdfs(robots: Path) -> dict[str, Path]:
    files = [*robots.glob("*/urdf/*.urdf"), *robots.glob("*/robots/*.urdf")]
    found: dict[str, Path] = {}
    for ending in _ENDINGS:
        for file in sorted(file for file in files if file.stem.endswith(ending)):
            found.setdefault(file.stem.removesuffix(ending), file)
    return found


Read = TypeVar("Read")

BUILT_IN = Path(robot.arms.__file__).parent

# How a joint's limit in MoveIt's joint_limits.yaml is switched on, and its key.
MOVEIT_LIMITS = (
    ("has_velocity_limits", "max_velocity"),
    ("has_acceleration_limits", "max_acceleration"),
    ("has_jerk_limits", "max_jerk"),
)
MOVEIT_POSITION_LIMITS = (("min_position", "lower"), ("max_position", "upper"))

MAX_YAML_BYTES = 1_000_000
MAX_SHAPES_BYTES = 20_000_000  # of all links; 600,000 vertices, which take 150 MB when they are read


@dataclass(frozen=True)
class RobotFolder:
    """An arm by its folder."""

    name: str
    title: str  # name of the arm for people
    model: RobotModel
    hardware: HardwareTable
    folder: Path
    cameras: Mapping[str, Camera] = field(default_factory=dict)  # rendered cameras by name, each in the frame of a link


def built_in_names() -> list[str]:
    return sorted(path.parent.name for path in BUILT_IN.glob(f"*/{robot_file.FILE_NAME}"))


def find(name_or_folder: str) -> Path:
    """Find the folder of a built-in arm by its name, or of another arm by its path."""
    path = Path(name_or_folder).expanduser()
    built_in = BUILT_IN / name_or_folder
    if path.name == name_or_folder and (built_in / robot_file.FILE_NAME).is_file():
        return built_in
    if path.name == robot_file.FILE_NAME and path.is_file():
        return path.parent
    if path.is_dir():
        return path
    raise DescriptionError(
        f"robot {name_or_folder!r}",
        f"is no folder, and no built-in arm ({', '.join(built_in_names())}); others come with the package "
        "example-robot-data (pip install example-robot-data)",
    )


def built_in(name: str) -> RobotFolder:
    return load(find(name))


def resolve(
    name_or_folder: str, *, urdf: Path | None = None, srdf: Path | None = None, package_directories: Sequence[Path] = ()
) -> RobotFolder:
    """Load an arm by the name of a built-in one, by its folder, or by its name in the package example-robot-data."""
    try:
        folder = find(name_or_folder)
    except DescriptionError:
        if (example := find_example(name_or_folder)) is None:
            raise
        packages = (*package_directories, *example.packages)
        arm = model.load(urdf or example.urdf, srdf or example.srdf, packages)
        return RobotFolder(name_or_folder, name_or_folder, arm, HardwareTable(), example.urdf.parent)
    return load(folder, urdf=urdf, srdf=srdf, package_directories=package_directories)


def problems(name_or_folder: str) -> tuple[str, ...]:
    """Return everything that is wrong with an arm, a sentence each."""
    try:
        resolve(name_or_folder)
    except RobotFileError as error:
        return error.problems
    except DescriptionError as error:
        return (str(error),)
    return ()


def load(
    folder: Path, *, urdf: Path | None = None, srdf: Path | None = None, package_directories: Sequence[Path] = ()
) -> RobotFolder:
    """Load an arm from its folder, without its shapes for another URDF; a RobotFileError names all its problems."""
    path = folder / robot_file.FILE_NAME
    if not folder.is_dir():
        raise DescriptionError(str(folder), "is no folder")
    if not path.is_file():
        raise DescriptionError(str(folder), f"has no {robot_file.FILE_NAME}: armbridge robot import URDF drafts one")
    file = robot_file.read(path)
    problems: list[str] = []
    no_limits: dict[str, JointLimits] = {}
    limits = _read(problems, lambda: _limits(folder, file), no_limits)
    own = urdf is None
    urdf = urdf or _read(problems, lambda: _description_file(folder, file.robot.urdf, "urdf"), None)
    srdf = srdf or _read(problems, lambda: _description_file(folder, file.robot.srdf, "srdf"), None)
    packages = (*package_directories, *((folder / package).resolve() for package in file.robot.packages))
    shapes: dict[str, Any] = {}
    readers: dict[str, Callable[[Path], Any]] = {"hulls": _hulls, "parts": _parts, "surfaces": _surfaces}
    for key, read in readers.items():
        named: Path | None = getattr(file.robot, key)
        if own and named is not None:
            shapes[key] = _read(problems, partial(read, (folder / named).resolve()), {})
    if urdf is None or srdf is None:
        raise RobotFileError(path, problems)
    describe = partial(model.load, urdf, srdf, packages, limits, needs_meshes=not shapes.get("hulls"))
    arm = _read(problems, describe, None)
    if arm is None:
        raise RobotFileError(path, problems)
    # Frames belong to the folder's URDF, as shapes do.
    cameras = _cameras(file, arm, problems) if own else {}
    problems += _unknown_names(file, replace(arm, **shapes))
    if problems:
        raise RobotFileError(path, problems)
    if file.held_joints:
        arm = describe(held=file.held_joints)
    group = file.planning.group or arm.default_group
    arm = replace(
        arm,
        **shapes,
        gripper=arm.gripper if file.gripper is None else GripperModel(**file.gripper.model_dump()),
        default_group=group,
        tip_link=file.planning.tip or arm.groups[group].tip_link,
        park_state=file.planning.park or arm.park_state,
    )
    name = folder.resolve().name
    return RobotFolder(name, file.robot.title or name, arm, _hardware(file, arm), folder, cameras)


def _cameras(file: RobotFile, arm: RobotModel, problems: list[str]) -> dict[str, Camera]:
    """Return the cameras, each in the frame of a link; a link that is none is a problem."""
    named = {name: each.frame or arm.root_link for name, each in file.cameras.items()}
    problems += [
        f"cameras.{name}.frame: the URDF has no link {frame!r}"
        for name, frame in named.items()
        if frame not in arm.links
    ]
    return {name: each.model_copy(update={"frame": named[name]}) for name, each in file.cameras.items()}


def _read(problems: list[str], read: Callable[[], Read], instead: Read) -> Read:
    """Read something; when that fails, keep the problem and return the substitute."""
    try:
        return read()
    except DescriptionError as error:
        problems.append(str(error))
        return instead


def _description_file(folder: Path, named: Path | None, kind: str) -> Path:
    if named is not None:
        path = folder / named
        if not path.is_file():
            raise DescriptionError(f"robot.{kind}:", f"there is no file {path}")
        return path
    there = sorted(folder.glob(f"*.{kind}"))
    if len(there) != 1:
        has = f"has {', '.join(path.name for path in there)}" if there else f"has no .{kind} file"
        raise DescriptionError(f"robot.{kind}:", f"is missing, and the folder {has}: name one")
    return there[0]


def _limits(folder: Path, file: RobotFile) -> dict[str, JointLimits]:
    """Return the limits that replace the URDF's: MoveIt's, and before them the limits of ``robot.toml``."""
    limits = {} if file.robot.joint_limits is None else moveit_limits(folder / file.robot.joint_limits)
    for name, table in file.joints.items():
        own = {key: value for key, value in table.model_dump().items() if value is not None}
        limits[name] = replace(limits.get(name, JointLimits()), **own)
    return limits


def moveit_limits(path: Path) -> dict[str, JointLimits]:
    """Read MoveIt's joint_limits.yaml (MoveIt's tutorial on the RobotModel's limits and joint_limits_aggregator)."""
    # Imported where it is needed: most arms have no joint_limits.yaml.
    import yaml

    try:
        with path.open("rb") as stream:
            values = yaml.safe_load(stream.read(MAX_YAML_BYTES))
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        raise DescriptionError(str(path), f"cannot be read: {' '.join(str(error).split())}") from error
    joints = values.get("joint_limits") if isinstance(values, dict) else None
    if not isinstance(joints, dict):
        raise DescriptionError(str(path), "has no mapping joint_limits")
    limits = {}
    for name, entry in joints.items():
        if not isinstance(entry, dict):
            raise DescriptionError(str(path), f"joint_limits.{name} must be a mapping, not {reprlib.repr(entry)[:80]}")
        own = {key: _yaml_number(path, name, entry, key) for switch, key in MOVEIT_LIMITS if entry.get(switch)}
        for key, value in own.items():
            if value <= 0.0:
                raise DescriptionError(str(path), f"joint_limits.{name}.{key} must be above 0, not {value:g}")
        if entry.get("has_position_limits"):
            own |= {field: _yaml_number(path, name, entry, key) for key, field in MOVEIT_POSITION_LIMITS}
        limits[str(name)] = JointLimits(**own)
    return limits


def _yaml_number(path: Path, name: str, entry: Mapping[str, Any], key: str) -> float:
    value = entry.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= robot_file.MAX_RATE:
        wanted = f"must be a number, not {reprlib.repr(value)[:80]} (at most {robot_file.MAX_RATE:g})"
        raise DescriptionError(str(path), f"joint_limits.{name}.{key} {wanted}")
    return float(value)


def _read_shapes(path: Path) -> Mapping[str, Any]:
    try:
        with path.open("rb") as stream:
            text = stream.read(MAX_SHAPES_BYTES + 1)
        links = json.loads(text)["links"] if len(text) <= MAX_SHAPES_BYTES else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error
    if len(text) > MAX_SHAPES_BYTES:
        raise DescriptionError(str(path), f"has more than {MAX_SHAPES_BYTES} bytes")
    if not isinstance(links, dict):
        raise DescriptionError(str(path), "must have an object links")
    return links


def _hulls(path: Path) -> dict[str, Hull]:
    try:
        return {
            link: Hull(_points(shape["vertices"]), np.asarray(shape["triangles"], dtype=np.int32).reshape(-1, 3))
            for link, shape in _read_shapes(path).items()
        }
    except (KeyError, TypeError, ValueError) as error:
        raise DescriptionError(str(path), f"must have vertices and triangles for each link: {error}") from error


def _parts(path: Path) -> dict[str, tuple[NDArray[np.float64], ...]]:
    try:
        return {link: tuple(_points(vertices) for vertices in shapes) for link, shapes in _read_shapes(path).items()}
    except (TypeError, ValueError) as error:
        raise DescriptionError(str(path), f"must have a list of vertices for each part: {error}") from error


def _surfaces(path: Path) -> dict[str, LinkSurface]:
    with surface_file(path) as arrays:
        names = list(arrays)
    return {link: LinkSurface(path, link) for link in dict.fromkeys(name.rpartition(".")[0] for name in names)}


def _points(vertices: object) -> NDArray[np.float64]:
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise ValueError("a vertex has a coordinate that is no finite number")
    return points


def _unknown_names(file: RobotFile, arm: RobotModel) -> Iterable[str]:
    movable = {joint.name for joint in arm.movable_joints}
    listed = ", ".join(sorted(movable))
    named = [(f"gripper.joints[{i}]", name) for i, name in enumerate(file.gripper.joints if file.gripper else ())]
    named += [(f"joints.{name}", name) for name in file.joints]
    named += [(f"held_joints.{name}", name) for name in file.held_joints]
    named += [(f"hardware.servos[{row}].joint", servo.joint) for row, servo in enumerate(file.hardware.servos)]
    for key, name in named:
        if name not in movable:
            yield f"{key}: the URDF has no movable joint {name!r}, but {listed}"
    described: Mapping[str, Iterable[str]] = {
        "robot.hulls": arm.hulls,
        "robot.parts": arm.parts,
        "robot.surfaces": arm.surfaces,
    }
    for key, links in described.items():
        for link in links:
            if link not in arm.links:
                yield f"{key}: the URDF has no link {link!r}"
    for name, position in file.held_joints.items():
        joint = arm.joints.get(name)
        if joint is not None and joint.movable and not joint.lower <= position <= joint.upper:
            yield f"held_joints.{name}: must be from {joint.lower:g} to {joint.upper:g}, not {position:g}"
    if file.hardware.servos:
        with_servo = {servo.joint for servo in file.hardware.servos}
        for name in sorted(movable - with_servo - file.held_joints.keys()):
            yield f"hardware.servos: joint {name!r} has no servo: give it one, or a place in [held_joints]"
        for name in sorted(with_servo & file.held_joints.keys()):
            yield f"held_joints.{name}: has a servo, which would drive it: leave one of the two out"
    if file.planning.group is not None and file.planning.group not in arm.groups:
        yield f"planning.group: the SRDF has no group {file.planning.group!r}, but {', '.join(arm.groups)}"
    if file.planning.tip is not None and file.planning.tip not in arm.links:
        yield f"planning.tip: the URDF has no link {file.planning.tip!r}"
    states = {state for of_group in arm.named_states.values() for state in of_group}
    if file.planning.park is not None and file.planning.park not in states:
        yield f"planning.park: the SRDF has no state {file.planning.park!r}, but {', '.join(sorted(states)) or 'none'}"
    if file.planning.frame not in (None, arm.root_link, arm.planning_frame):
        yield f"planning.frame: must be the root link {arm.root_link!r}, not {file.planning.frame!r}"


def _hardware(file: RobotFile, arm: RobotModel) -> HardwareTable:
    section = file.hardware
    gripper = arm.gripper.joints if arm.gripper is not None else ()
    servos = tuple(_servo(servo, section, arm, gripper=servo.joint in gripper) for servo in section.servos)
    return HardwareTable(section.kind, servos, section.baud, section.calibrations, section.profile)


def _servo(table: ServoTable, section: HardwareSection, arm: RobotModel, *, gripper: bool) -> ServoSpec:
    joint = arm.joints[table.joint]
    zero: Zero
    match table.zero:
        case "ends":
            zero = "ends"
        case "middle":
            zero = ZeroTick()
        case place:
            zero = ZeroTick(None if place.tick == "middle" else place.tick, place.angle_rad)
    return ServoSpec(
        joint=table.joint,
        servo_id=table.id,
        lower_rad=joint.lower,
        upper_rad=joint.upper,
        model=table.model.lower(),
        sign=table.sign,
        zero=zero,
        turns_freely=table.turns_freely,
        gripper=gripper,
        max_homing_offset=MAX_HOMING_OFFSET[section.kind],
    )
