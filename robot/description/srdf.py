"""Groups, named states, end effectors and unchecked pairs of an SRDF."""

import logging
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from robot.description.urdf import Joint, Tree, attribute, number, root_of
from robot.errors import DescriptionError

log = logging.getLogger("armbridge.description")


MAX_NESTED_GROUPS = 20


@dataclass(frozen=True)
class Group:
    """Planning group of the SRDF: joints that move together."""

    name: str
    joints: tuple[str, ...]  # joints with a position of their own, from the root outwards
    base_link: str  # link from which the chain starts; without a chain, the parent of the first joint
    tip_link: str  # link to which the chain leads; empty where the joints are not one chain


class EndEffector(NamedTuple):
    """Group that is an end effector, and the link that carries it."""

    group: str
    parent_link: str


@dataclass(frozen=True)
class Semantics:
    """Content of an SRDF."""

    groups: Mapping[str, Group]  # planning groups by name, those without a movable joint left out
    # Group name -> state name -> joint name -> position [rad].
    named_states: Mapping[str, Mapping[str, Mapping[str, float]]]
    disabled_pairs: frozenset[frozenset[str]]
    end_effectors: tuple[EndEffector, ...]
    passive_joints: frozenset[str]  # movable joints that nothing drives
    planning_frame: str  # frame from which a virtual joint leads to the root link; without one, the root link


def read_srdf(text: str, source: str, tree: Tree) -> Semantics:
    """Read an SRDF that belongs to links and joints of a URDF."""
    return _Reader(root_of(text, source), source, tree).read()


def with_group(text: str, source: str, tree: Tree) -> str:
    """Return an SRDF that has a group: where it has none, "arm", the chain to the link behind the most joints."""
    root = root_of(text, source)
    if root.find("group") is not None:
        return text
    tip = _farthest_link(tree)
    chain = ET.SubElement(ET.SubElement(root, "group", name="arm"), "chain", base_link=tree.links[0], tip_link=tip)
    log.warning("%s has no <group>: the group 'arm' is the longest chain, %s", source, chain.attrib)
    return ET.tostring(root, encoding="unicode")


def _farthest_link(tree: Tree) -> str:
    by_child = {joint.child: joint for joint in tree.joints.values()}
    joint_count = {tree.links[0]: 0}
    for link in tree.links[1:]:
        joint_count[link] = joint_count[by_child[link].parent] + by_child[link].movable
    return max(tree.links, key=joint_count.__getitem__)


class _Reader:
    def __init__(self, root: ET.Element, source: str, tree: Tree) -> None:
        self._root, self._source, self._tree = root, source, tree
        self._by_child = {joint.child: joint for joint in tree.joints.values()}
        self._virtual = {attribute(each, "name", source): each for each in root.iterfind("virtual_joint")}
        self._passive = frozenset(self._passive_joints())
        self._elements = {attribute(group, "name", source): group for group in root.iterfind("group")}
        self._found: dict[str, set[str]] = {}  # members of the groups that were read

    def read(self) -> Semantics:
        found = (self._group(name) for name in self._elements)
        groups = {group.name: group for group in found if group.joints}
        if not groups:
            chain = f'<chain base_link="{self._tree.links[0]}" tip_link="{_farthest_link(self._tree)}"/>'
            problem = "has no <group> with a movable joint of the URDF: add"
            raise DescriptionError(self._source, f'{problem} <group name="arm">{chain}</group>')
        end_effectors = tuple(self._end_effectors())
        for effector in end_effectors:
            if effector.group in groups:
                groups[effector.group] = self._with_tip(groups[effector.group], effector)
        root_link = self._tree.links[0]
        at_root = (each for each in self._virtual.values() if each.get("child_link") == root_link)
        frame = next((attribute(each, "parent_frame", self._source) for each in at_root), root_link)
        states, pairs = self._named_states(groups), self._disabled_pairs()
        return Semantics(groups, states, pairs, end_effectors, self._passive, frame)

    def _passive_joints(self) -> Iterator[str]:
        for element in self._root.iterfind("passive_joint"):
            name = attribute(element, "name", self._source)
            if name not in self._virtual and self._joint(name, "<passive_joint>").movable:
                yield name

    def _group(self, name: str) -> Group:
        names = self._members(name, ())
        # From the root outwards, as MoveIt orders them, whatever their order in the file.
        by_link = (self._by_child.get(link) for link in self._tree.links)
        members = [joint for joint in by_link if joint is not None and joint.name in names]
        driven = [joint for joint in members if joint.movable and joint.name not in self._passive]
        base_link, tip_link = self._ends(name, members, driven)
        return Group(name, tuple(joint.name for joint in driven), base_link, tip_link)

    def _members(self, name: str, within: tuple[str, ...]) -> set[str]:
        where = f"{self._source} group {name!r}"
        if name in within:
            raise DescriptionError(where, f"contains itself: {' -> '.join((*within, name))}")
        if len(within) > MAX_NESTED_GROUPS:
            raise DescriptionError(where, f"is nested in more than {MAX_NESTED_GROUPS} groups")
        if name in self._found:
            return self._found[name]
        members: set[str] = set()
        for element in self._elements[name]:
            match element.tag:
                case "joint":
                    joint = attribute(element, "name", where)
                    if joint not in self._virtual:
                        members.add(self._joint(joint, f"group {name!r} <joint>").name)
                case "link":
                    carrier = self._by_child.get(
                        self._link(attribute(element, "name", where), f"group {name!r} <link>")
                    )
                    members |= set() if carrier is None else {carrier.name}
                case "chain":
                    members |= {joint.name for joint in self._chain(element, name)}
                case "group":
                    inner = attribute(element, "name", where)
                    if inner not in self._elements:
                        known = ", ".join(self._elements)
                        raise DescriptionError(
                            where, f"contains the group {inner!r}, which does not exist ({known} do)"
                        )
                    members |= self._members(inner, (*within, name))
        self._found[name] = members
        return members

    def _chain(self, element: ET.Element, group: str) -> list[Joint]:
        """Return the joints of a <chain>, base first; from a branch to another it leads by way of what carries both."""
        where = f"group {group!r} <chain>"
        base, tip = (self._link(attribute(element, end, self._source), where) for end in ("base_link", "tip_link"))
        to_base, to_tip = self._path(base), self._path(tip)
        beyond = [joint for joint in to_tip if joint not in to_base]
        if not beyond:
            raise DescriptionError(
                self._source, f"group {group!r}: no chain leads from {base!r} to {tip!r}: exchange them, or correct one"
            )
        return [joint for joint in to_base if joint not in to_tip][::-1] + beyond

    def _ends(self, name: str, members: Sequence[Joint], driven: Sequence[Joint]) -> tuple[str, str]:
        """Return base and tip of a group's joints; an empty tip where they are not one chain."""
        if not driven:
            return self._tree.links[0], ""
        chains = self._elements[name].findall("chain")
        if len(chains) == 1:
            on_chain = {joint.name for joint in self._chain(chains[0], name)}
            if all(joint.name in on_chain for joint in driven):
                return attribute(chains[0], "base_link", self._source), attribute(chains[0], "tip_link", self._source)
        path = self._path(driven[-1].child)
        if not all(joint in path for joint in driven):
            return driven[0].parent, ""
        first = next(joint for joint in path if joint in members)
        # Links fixed to the last joint and in the group go on to the tip, as long as they do not branch.
        beyond = [joint for joint in members if driven[-1] in self._path(joint.child)]
        farthest = max(beyond, key=lambda joint: len(self._path(joint.child)))
        tip = farthest if all(joint in self._path(farthest.child) for joint in beyond) else driven[-1]
        return first.parent, tip.child

    def _path(self, link: str) -> list[Joint]:
        path: list[Joint] = []
        while link in self._by_child:
            path.append(self._by_child[link])
            link = self._by_child[link].parent
        return path[::-1]

    def _end_effectors(self) -> Iterator[EndEffector]:
        for element in self._root.iterfind("end_effector"):
            name = attribute(element, "name", self._source)
            group, where = attribute(element, "group", self._source), f"end_effector {name!r}"
            if group not in self._elements:
                raise DescriptionError(f"{self._source} {where}", f"names the group {group!r}, which does not exist")
            yield EndEffector(group, self._link(attribute(element, "parent_link", self._source), where))

    def _with_tip(self, group: Group, effector: EndEffector) -> Group:
        """Return a group with the tip that an end effector gives it: where it names the arm itself, as Panda's does."""
        beyond = self._path(effector.parent_link)
        driven = tuple(joint.name for joint in beyond if joint.movable)
        if group.tip_link and driven[-len(group.joints) :] == group.joints:
            return replace(group, tip_link=effector.parent_link)
        return group

    def _named_states(self, groups: Mapping[str, Group]) -> dict[str, dict[str, dict[str, float]]]:
        states: dict[str, dict[str, dict[str, float]]] = {}
        for element in self._root.iterfind("group_state"):
            name = attribute(element, "name", self._source)
            positions = {}
            for member in element.iterfind("joint"):
                joint_name = attribute(member, "name", self._source)
                # A floating base has seven values, and not always a <virtual_joint>.
                if joint_name in self._virtual or len(member.get("value", "").split()) > 1:
                    continue
                joint = self._joint(joint_name, f"group_state {name!r} <joint>")
                if joint.movable and joint.name not in self._passive:
                    where = f"{self._source} group_state {name!r} joint {joint_name!r}"
                    positions[joint_name] = number(member, "value", where)
            group = element.get("group") or self._group_of_state(name, positions, groups)
            if group in groups and positions:
                states.setdefault(group, {})[name] = positions
        return states

    def _group_of_state(self, name: str, positions: Mapping[str, float], groups: Mapping[str, Group]) -> str:
        """Return the smallest group that has all joints of a state that names none, as Kinova's."""
        having = [group for group in groups.values() if set(positions) <= set(group.joints)]
        if not having:
            raise DescriptionError(f"{self._source} group_state {name!r}", "has no attribute 'group'")
        return min(having, key=lambda group: len(group.joints)).name

    def _disabled_pairs(self) -> frozenset[frozenset[str]]:
        """Return the unchecked pairs; links that the URDF lacks are allowed: they touch nothing."""
        source, links = self._source, self._tree.links
        resting = [attribute(each, "link", source) for each in self._root.iterfind("disable_default_collisions")]
        pairs = {frozenset((link, other)) for link in resting for other in links if other != link}
        pairs -= set(self._pairs("enable_collisions"))
        return frozenset(pairs | set(self._pairs("disable_collisions")))

    def _pairs(self, tag: str) -> Iterator[frozenset[str]]:
        for pair in self._root.iterfind(tag):
            yield frozenset((attribute(pair, "link1", self._source), attribute(pair, "link2", self._source)))

    def _joint(self, name: str, where: str) -> Joint:
        if name not in self._tree.joints:
            raise self._unknown("joint", name, where)
        return self._tree.joints[name]

    def _link(self, name: str, where: str) -> str:
        if name not in self._tree.links:
            raise self._unknown("link", name, where)
        return name

    def _unknown(self, kind: str, name: str, where: str) -> DescriptionError:
        own, robot = self._root.get("name", ""), self._tree.name
        remedy = "correct the name, or give the SRDF that belongs to this URDF"
        if own != robot:
            remedy += f" (this one is of the robot {own!r})"
        return DescriptionError(
            f"{self._source} {where}", f"names the {kind} {name!r}, which the URDF of {robot!r} does not have: {remedy}"
        )
