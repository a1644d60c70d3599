from __future__ import annotations

import numpy as np

from planners.assistant.link_shapes import link_surfaces
from robot.description import model
from tests.helpers import robots


def test_surfaces_of_the_builtin_arm_are_the_official_meshes(robot, shared_data) -> None:
    official = model.load(shared_data / "so101" / "so101_new_calib.urdf", robots.SO101.folder / "so101.srdf")
    expected = link_surfaces(official)
    with np.load(robot.surfaces["base_link"].path) as file:
        assert set(file.files) == expected.keys()
        for name, array in expected.items():
            assert np.array_equal(file[name], array)
