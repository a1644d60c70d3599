"""A made-up arm of STL meshes, and the folder that the assistant makes of it."""

from pathlib import Path

import pytest

from planners.assistant import link_shapes
from planners.assistant.importing import ImportOptions, import_robot
from tests.helpers.stl_arm import write_package


@pytest.fixture(scope="package")
def urdf(tmp_path_factory) -> Path:
    return write_package(tmp_path_factory.mktemp("packages"))


@pytest.fixture(scope="package")
def imported(urdf, tmp_path_factory) -> tuple[Path, list[str], list[str]]:
    """The folder, the lines about it, and the progress."""
    out, progress = tmp_path_factory.mktemp("out") / "arm", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(link_shapes, "POINTS", 100_000)
        lines = import_robot(ImportOptions(urdf, out, samples=600), progress.append)
    return out, lines, progress
