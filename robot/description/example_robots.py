"""Robots of the package example-robot-data, which brings the descriptions of some fifty published ones."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from robot.errors import DescriptionError

PACKAGE = "example-robot-data"

# Where the package keeps its descriptions; their meshes are named package://example-robot-data/robots/...
_SHARE = f"cmeel.prefix/share/{PACKAGE}"

# Endings that a file may have beyond the robot's name, the plainest first.
_ENDINGS = ("", "_robot", "_reduced")


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
        raise DescriptionError(
            f"{PACKAGE}'s robot {name!r}",
            f"has no SRDF ({srdf} is not there): write one, and give it with --srdf beside --urdf {urdf}",
        )
    return ExampleRobot(urdf, srdf, (robots.parents[1],))


def _robots() -> Path | None:
    """Return the package's folder of robots; None without the package."""
    try:
        folder = Path(str(metadata.distribution(PACKAGE).locate_file(_SHARE))) / "robots"
    except metadata.PackageNotFoundError:
        return None
    return folder if folder.is_dir() else None


def _urdfs(robots: Path) -> dict[str, Path]:
    """Return the URDF of each robot by its name, from packages with a folder urdf or robots."""
    files = [*robots.glob("*/urdf/*.urdf"), *robots.glob("*/robots/*.urdf")]
    found: dict[str, Path] = {}
    for ending in _ENDINGS:
        for file in sorted(file for file in files if file.stem.endswith(ending)):
            found.setdefault(file.stem.removesuffix(ending), file)
    return found
