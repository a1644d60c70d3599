"""Import of a URDF: a robot folder that can be served, made in steps, checked, and put in place as a whole.

The folder has copies of the URDF and of its meshes, so that it can be moved.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planners.assistant.decomposition import MAX_PARTS, MAX_TIME_S, TOLERANCE_M, Limits
from planners.assistant.draft import ARM, Draft, Structure, Tree, draft_gripper, find_structure, robot_toml, srdf
from planners.assistant.link_shapes import (
    LinkParts,
    LinkShape,
    convex_links,
    draw_picture,
    link_shapes,
    parts_in_link,
    primitive_points,
    shapes_in_link,
    surface_of,
)
from planners.assistant.pairs import NEVER, SelfContacts, free_state, unchecked_pairs
from planners.assistant.surface import ConvexPart, Surface, sample
from planners.errors import AssistantError
from planners.geometry.shapes import enclosing
from planners.goals import JointGoal
from planners.pipeline import Planner
from planners.problem import Plan, PlanningProblem
from robot.description import model, robot_file, robot_folder
from robot.description.meshes import find_mesh
from robot.description.model import RobotModel
from robot.description.urdf import MOVABLE_TYPES, root_of

MESHES = "meshes"

MAX_MESH_BYTES = 500 << 20  # size of the meshes of one robot: twenty times the SO-101's


def parse_urdf(urdf_path: Path) -> ET.Element:
    """Read a URDF; AssistantError for a file that cannot be read, DescriptionError for a file that is no URDF."""
    try:
        text = urdf_path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AssistantError(f"{urdf_path} cannot be read: {error}") from error
    return root_of(text, str(urdf_path))


def copy_meshes(root: ET.Element, urdf_path: Path, packages: Sequence[Path], folder: Path) -> int:
    """Copy a URDF's meshes to a folder, name the copies in ``root``, and return their number."""
    names: dict[Path, str] = {}
    total_bytes = 0
    for link in root.iterfind("link"):
        for shape in [*link.findall("collision"), *link.findall("visual")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            source = _source(mesh, shape, urdf_path, packages)
            if source is None:
                link.remove(shape)
                continue
            if source not in names:
                total_bytes += source.stat().st_size
                if total_bytes > MAX_MESH_BYTES:
                    raise AssistantError(
                        f"the meshes of {urdf_path} have more than {MAX_MESH_BYTES >> 20} MiB: simplify them"
                    )
                names[source] = _free_name(source, set(names.values()))
                (folder / MESHES).mkdir(exist_ok=True)
                shutil.copyfile(source, folder / MESHES / names[source])
                # An OBJ file names its materials by their file.
                material = source.with_suffix(".mtl")
                if source.suffix.lower() == ".obj" and material.is_file():
                    shutil.copyfile(material, folder / MESHES / material.name)
            mesh.set("filename", f"{MESHES}/{names[source]}")
    return len(names)


def _source(mesh: ET.Element, shape: ET.Element, urdf_path: Path, packages: Sequence[Path]) -> Path | None:
    """Return the file of a mesh; None for a visual mesh that does not exist."""
    try:
        return find_mesh(mesh.get("filename", ""), urdf_path.resolve().parent, packages)
    except Exception:
        if shape.tag == "visual":
            return None
        raise


def _free_name(source: Path, taken: set[str]) -> str:
    """Return a name in the folder of meshes: the file's, with its folder's in front where that is taken."""
    name, number = source.name, 1
    if name in taken:
        name = f"{source.parent.name}_{source.name}"
    while name in taken:
        number += 1
        name = f"{source.parent.name}_{number}_{source.name}"
    return name


SAMPLES = 20_000
MAX_SAMPLES = 1_000_000

# Draws of a home that touches nothing, and of goals of the plan that proves the folder.
HOME_TRIES = 2_000
PROOF_TRIES = 5

GRIPPER_POINTS = 300  # points on a finger and on the hand that their distance is taken from
DIGITS = 5  # digits of the shapes' coordinates: 10 um

PICTURE = "parts.png"


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import."""

    urdf: Path
    out: Path  # folder to make
    packages: tuple[Path, ...] = ()  # folders for `package://`
    base: str | None = None  # first link of the arm; None for the root
    tip: str | None = None  # last link of the arm; None to find it
    samples: int = SAMPLES  # states drawn for the pairs
    seed: int = 0  # of all draws: same files and options, same folder
    convex: bool = True  # whether convex parts are made; else the meshes are checked themselves
    overwrite: bool = False  # whether a robot folder that is there is replaced


def default_folder(urdf: Path) -> Path:
    """Return the folder that a URDF is imported to: the robot's name, in the working directory."""
    return Path(_file_name(parse_urdf(urdf).get("name", urdf.stem)))


def import_robot(options: ImportOptions, say: Callable[[str], None]) -> list[str]:
    """Make a robot folder of a URDF, or none if it fails; ``say`` takes progress. Returns lines on what to check."""
    if not 1 <= options.samples <= MAX_SAMPLES:
        raise AssistantError(f"--samples {options.samples}: must be from 1 to {MAX_SAMPLES}")
    out = options.out.absolute()
    _check_target(out, options.overwrite)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.import-", dir=out.parent) as scratch:
        folder = Path(scratch) / out.name
        folder.mkdir()
        lines = _Import(options, folder, say).run()
        # Two names of one folder system: either the old folder is there or the new one.
        if out.exists():
            out.rename(Path(scratch) / "replaced")
        folder.rename(out)
    return lines


def _check_target(out: Path, overwrite: bool) -> None:
    if out.exists() and not overwrite:
        raise AssistantError(f"{out} is there already: give another folder by --out, or --overwrite to replace it")
    if out.exists() and not (out / robot_file.FILE_NAME).is_file():
        raise AssistantError(
            f"{out} has no {robot_file.FILE_NAME}, so it is no robot folder and is not replaced: give another --out"
        )


class _Import:
    """One import into an empty folder, step by step; ``say`` takes a line of progress."""

    def __init__(self, options: ImportOptions, folder: Path, say: Callable[[str], None]) -> None:
        self._options, self._folder, self._say = options, folder, say
        self._notes: list[str] = []

    def run(self) -> list[str]:
        options, folder, say = self._options, self._folder, self._say
        root = parse_urdf(options.urdf)
        name = _file_name(root.get("name", options.urdf.stem))
        robot = self._parse(root)
        count = copy_meshes(root, options.urdf, options.packages, folder)
        urdf_name, srdf_name = f"{name}.urdf", f"{name}.srdf"
        (folder / urdf_name).write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
        say(f"{options.urdf}: {len(root.findall('link'))} links, {count} meshes")
        shapes = link_shapes(robot)
        seen = [link.get("name", "") for link in root.iterfind("link") if link.find("visual") is not None]
        bare = ", ".join(link for link in seen if link not in shapes)
        if bare:
            self._notes.append(
                f"CHECK: {bare}: these links are seen but have no <collision>, so they may touch anything"
            )
        tree = Tree(robot.links, robot.joints)
        structure = find_structure(tree, frozenset(shapes), options.base, options.tip)
        say(f"arm: {', '.join(structure.arm_joints)}; tip {structure.tip_link}")
        say(f"gripper: {', '.join(structure.gripper_joints) or 'none'}")
        convex = self._convex(shapes) if options.convex else {}
        parts = {link: parts_in_link(link, found) for link, found in convex.items()}
        contacts = SelfContacts(robot, parts or {link: shapes_in_link(link, each) for link, each in shapes.items()})
        draft = self._draft(robot, tree, structure, shapes, contacts)
        (folder / srdf_name).write_text(srdf(draft), encoding="utf-8")
        written = [f"{urdf_name}: the URDF, its {count} meshes beside it", f"{srdf_name}: groups, named states, pairs"]
        files = {}
        if convex:
            files = {"hulls": "hulls.json", "parts": "parts.json"}
            self._write_shapes(convex)
            written.append(f"hulls.json, parts.json: {sum(len(each.parts) for each in convex.values())} convex parts")
        text = robot_toml(draft, urdf_name, srdf_name, files)
        (folder / robot_file.FILE_NAME).write_text(text, encoding="utf-8")
        written.append(f"{robot_file.FILE_NAME}: read its lines with CHECK")
        if convex:
            meshes = {link: _surfaces(link, of_link) for link, of_link in shapes.items()}
            drawn = {link: [part.surface for part in found.parts] for link, found in convex.items()}
            home = np.array([draft.home[joint] for joint in contacts.joint_names])
            draw_picture(folder / PICTURE, meshes, drawn, contacts.placements(home))
            written.append(f"{PICTURE}: the meshes beside the parts")
        return [*written, *self._prove(draft, contacts), *self._notes]

    def _parse(self, root: ET.Element) -> RobotModel:
        """Read the URDF with a provisional SRDF: one group of all joints. Errors name the user's own files."""
        joints = [joint for joint in root.iterfind("joint") if joint.get("type") in MOVABLE_TYPES]
        own = [joint.get("name", "") for joint in joints if joint.find("mimic") is None]
        if not own:
            raise AssistantError(f"{self._options.urdf} has no joint of a type that moves: {', '.join(MOVABLE_TYPES)}")
        group = ET.Element("robot", name=root.get("name", "robot"))
        element = ET.SubElement(group, "group", name=ARM)
        for name in own:
            ET.SubElement(element, "joint", name=name)
        return model.parse(
            ET.tostring(root, encoding="unicode"),
            ET.tostring(group, encoding="unicode"),
            mesh_directory=self._options.urdf.resolve().parent,
            package_directories=self._options.packages,
            sources=(f"URDF {self._options.urdf}", "SRDF draft"),
        )

    def _convex(self, shapes: Mapping[str, list[LinkShape]]) -> dict[str, LinkParts]:
        links: dict[str, LinkParts] = {}
        for link, found in convex_links(shapes, Limits(seed=self._options.seed)):
            links[link] = found
            greatest_mm = 1000.0 * found.deviation.greatest_m
            about = f"{len(found.parts)} convex parts"
            if found.meshes:
                about += f", at most {greatest_mm:.1f} mm from the mesh"
            self._say(f"link {len(links)} of {len(shapes)}, {link}: {about}")
            if found.deviation.greatest_m > TOLERANCE_M:
                self._notes.append(
                    f"CHECK: the parts of {link} are up to {greatest_mm:.1f} mm from its mesh,"
                    f" more than {1000.0 * TOLERANCE_M:g} mm, within {MAX_PARTS} parts and {MAX_TIME_S:g} s a mesh"
                )
        return links

    def _draft(
        self,
        robot: RobotModel,
        tree: Tree,
        structure: Structure,
        shapes: Mapping[str, list[LinkShape]],
        contacts: SelfContacts,
    ) -> Draft:
        samples, seed = self._options.samples, self._options.seed
        self._say(f"drawing {samples} states for the pairs of links")
        unchecked = unchecked_pairs(contacts, samples, seed, lambda done: self._say(f"  {done} of {samples} states"))
        never = sum(pair.reason == NEVER for pair in unchecked)
        total = len(contacts.pairs) + len(contacts.adjacent)
        self._say(f"pairs of links: {total}, {len(unchecked)} of them need no check ({never} never touch)")
        middle = 0.5 * (contacts.lower + contacts.upper)
        zero = np.where((contacts.lower <= 0.0) & (contacts.upper >= 0.0), 0.0, middle)
        home, free = free_state(contacts, unchecked, (zero, middle), HOME_TRIES, seed)
        if not free:
            self._notes.append(
                f"CHECK: links touch in every one of {HOME_TRIES} states, home too: the shapes overlap more than the"
                f" joints' neighbours; look at {PICTURE}"
            )
        gripper = None
        if structure.gripper_joints:
            random = np.random.default_rng(seed)
            points = {
                link: np.vstack([sample(each, GRIPPER_POINTS, random) for each in _surfaces(link, shapes[link])])
                for link in tree.links_below(structure.hand_link)
                if link in shapes
            }
            joints = [robot.joints[name] for name in structure.gripper_joints]
            gripper = draft_gripper(joints, structure.hand_link, tree, points, contacts, home)
        named = dict(zip(contacts.joint_names, home.tolist(), strict=True))
        return Draft(robot, structure, gripper, named, unchecked, samples)

    def _write_shapes(self, convex: Mapping[str, LinkParts]) -> None:
        source = "armbridge robot import: convex parts that cover the <collision> shapes of each link"
        units = "metres in the link's frame"
        hulls, parts = {}, {}
        for link, found in convex.items():
            rounded = [np.unique(part.vertices_m.round(DIGITS), axis=0) for part in found.parts]
            parts[link] = [vertices.tolist() for vertices in rounded]
            hull = ConvexPart(np.asarray(enclosing(np.vstack(rounded)).points()).round(DIGITS))
            hulls[link] = {"vertices": hull.vertices_m.tolist(), "triangles": hull.surface.triangles.tolist()}
        for name, links in (("hulls.json", hulls), ("parts.json", parts)):
            text = json.dumps({"source": source, "units": units, "links": links}, separators=(",", ":"))
            (self._folder / name).write_text(text + "\n", encoding="utf-8")

    def _prove(self, draft: Draft, contacts: SelfContacts) -> list[str]:
        """Load the folder as the server does, and plan a motion in it."""
        problems = robot_folder.problems(str(self._folder))
        if problems:
            raise AssistantError(f"the folder that was made cannot be used: {'; '.join(problems)}")
        robot = robot_folder.load(self._folder).model
        planner = Planner(robot)
        refusal = "links touch in all of them"
        for attempt in range(PROOF_TRIES):
            goal_state, free = free_state(contacts, draft.unchecked, (), HOME_TRIES, self._options.seed + attempt)
            if not free:
                break
            drawn = dict(zip(contacts.joint_names, goal_state.tolist(), strict=True))
            goal = JointGoal({name: drawn[name] for name in robot.groups[ARM].joints})
            answer = planner.plan(PlanningProblem(ARM, draft.home, goal, seed=self._options.seed))
            if isinstance(answer, Plan):
                return [f"checked: loads, and a motion of {answer.trajectory.duration_s:.1f} s from home is planned"]
            refusal = answer.message
        return [f"CHECK: no motion from home to one of {PROOF_TRIES} drawn states was found: {refusal}"]


def _surfaces(link: str, shapes: Sequence[LinkShape]) -> list[Surface]:
    found = []
    for shape in shapes:
        if shape.mesh is not None:
            surface = surface_of(link, shape.mesh)
        else:
            surface = ConvexPart(primitive_points(shape.geometry)).surface
        placed = surface.vertices_m @ shape.placement.rotation.T + shape.placement.translation
        found.append(Surface(placed, surface.triangles))
    return found


def _file_name(name: str) -> str:
    return re.sub(r"[^a-z0-9_-]+", "_", name.lower()).strip("_") or "robot"
