"""Build hook: a wheel that lacks one of its parts is not built."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# A file of each part, and how to get the part.
PARTS = {
    "server/page/dist/index.html": "the page: build it with make page",
    "server/page/dist/licenses.md": "the licences of the page's libraries: build the page with make page",
    "server/docs_site/index.html": "the site of the docs: build it with make docs",
    "docs/configuration.md": "the docs",
    "protocol/interfaces/ros2.json": "the message types",
    "robot/arms/so101/robot.toml": "the built-in arms",
    "robot/arms/so101/NOTICE": "the notice of the SO-101's meshes",
}


def missing(root: Path) -> list[str]:
    """Return the parts that are not in a checkout, each with its file."""
    return [f"{file} ({part})" for file, part in PARTS.items() if not (root / file).is_file()]


class PartsHook(BuildHookInterface[Any]):
    """Refuses to build an incomplete wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002
        """Check the parts; an editable install takes them from the checkout, whenever they are made."""
        if version != "editable" and (lacking := missing(Path(self.root))):
            raise FileNotFoundError(f"the wheel would lack {', '.join(lacking)}")
