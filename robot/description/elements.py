"""Elements of URDF and SRDF: roots, attributes and numbers, refused with file and element."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from robot.errors import DescriptionError

# Of elements that xacro replaces; descriptions in circulation use all three.
XACRO_NAMESPACES = ("http://www.ros.org/wiki/xacro", "http://wiki.ros.org/xacro", "http://ros.org/wiki/xacro")


def root_of(text: str, source: str) -> ET.Element:
    """Parse a URDF or SRDF, whose source is named in errors; xacro and MJCF are rejected with the next step."""
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file, given on the command line
    except ET.ParseError as error:
        raise DescriptionError(source, f"is not XML: {error}") from error
    if root.tag == "mujoco":
        raise DescriptionError(
            source,
            "is MJCF, MuJoCo's format: convert it to a URDF first (pip install mjcf-urdf-simple-converter), or use the "
            "URDF of the arm's maker, and give that",
        )
    if root.tag != "robot":
        raise DescriptionError(source, f"must start with <robot>, not <{root.tag}>")
    macros = (macro for element in root.iter() for macro in _macros(element))
    if macro := next(macros, ""):
        raise DescriptionError(
            source,
            f"is xacro, with {macro}: expand it first with "
            "`xacro FILE.xacro > FILE` (pip install xacro), and give the result",
        )
    return root


def attribute(element: ET.Element, name: str, source: str) -> str:
    """Return an attribute that must be there."""
    value = element.get(name)
    if value is None:
        raise DescriptionError(source, f"<{element.tag}> {element.attrib} has no attribute {name!r}")
    return value


def number(element: ET.Element, name: str, where: str) -> float:
    """Return an attribute that must be a finite number; ``where`` names file and element in errors."""
    text = element.get(name)
    if text is None:
        raise DescriptionError(where, f"has no attribute {name!r}")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DescriptionError(where, f"{name} must be a finite number, not {text!r}")
    return value


def _macros(element: ET.Element) -> list[str]:
    """Return the parts of an element that xacro replaces: the element itself, and expressions in its attributes."""
    if element.tag.startswith(tuple(f"{{{namespace}}}" for namespace in XACRO_NAMESPACES)):
        return [f"the element <xacro:{element.tag.rpartition('}')[2]}>"]
    return [f'{name}="{value}"' for name, value in element.attrib.items() if "${" in value or "$(" in value]
