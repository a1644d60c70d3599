"""Elements of URDF and SRDF: roots, attributes and numbers, refused with file and element."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from robot.errors import DescriptionError

# Of elements that xacro replaces; descriptions in circulation use all three.
XACRO_NAMESPACES = ("http://www.ros.org/wiki/xacro", "http://wiki.ros.org/xacro", "http://ros.org/wiki/xacro")


def root_of(text: str, source: str) -> ET.Element:
    """Parse a URDF or SRDF, whose source is named in errors; xacro is rejected."""
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file, given on the command line
    except ET.ParseError as error:
        raise DescriptionError(source, f"is not XML: {error}") from error
    if root.tag != "robot":
        raise DescriptionError(source, f"must start with <robot>, not <{root.tag}>")
    macros = [element.tag for element in root.iter() if _is_xacro(element)]
    if macros:
        raise DescriptionError(
            source,
            f"is xacro, with the element <xacro:{macros[0].rpartition('}')[2]}>: expand it first with "
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


def _is_xacro(element: ET.Element) -> bool:
    return element.tag.startswith(tuple(f"{{{namespace}}}" for namespace in XACRO_NAMESPACES))
