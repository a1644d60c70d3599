"""Pictures of the physics for the documentation: ``make pictures`` copies them to docs/pictures."""

import numpy as np
import pytest
from PIL import Image

from harness.server import ROOT
from robot.description import robot_folder
from robot.description.camera import Camera
from robot.physics.bodies import Body, BodyShape
from robot.physics.renderer import ArmRenderer
from tests.helpers.rendering import needs_egl, red_pixels

LEVEL = (0.0, 0.0, 0.0, 1.0)
CUBES = {
    "red": ((0.2, -0.009, 0.0125), (0.8, 0.1, 0.1, 1.0)),
    "green": ((0.24, 0.06, 0.0125), (0.1, 0.6, 0.2, 1.0)),
    "blue": ((0.24, -0.08, 0.0125), (0.1, 0.3, 0.8, 1.0)),
    "yellow": ((0.3, 0.02, 0.0125), (0.8, 0.7, 0.1, 1.0)),
    "orange": ((0.3, 0.02, 0.0375), (0.9, 0.5, 0.1, 1.0)),
}
ABOVE = {"shoulder_lift": -0.456, "elbow_flex": 0.246, "wrist_flex": 1.6, "wrist_roll": -1.52, "gripper": 1.0}
PICTURES, COLOURS, MAX_BYTES = ROOT / "build/page/pictures", 64, 40_000


@needs_egl
@pytest.mark.parametrize(("name", "width", "height"), [("front", 480, 360), ("wrist", 320, 240)])
def test_a_world_is_pictured_by_the_arms_cameras(name: str, width: int, height: int) -> None:
    arm = robot_folder.built_in("so101")
    size = {"width": width, "height": height}
    renderer = ArmRenderer(arm.model, {name: Camera(**{**arm.cameras[name].model_dump(), **size})})
    renderer.place(ABOVE)
    shape = BodyShape("box", (0.0125,) * 3, (0.0, 0.0, 0.0), LEVEL)
    bodies = tuple(Body(cube, (shape,), at, LEVEL, movable=True) for cube, (at, _) in CUBES.items())
    renderer.set_bodies(bodies, {cube: color for cube, (_, color) in CUBES.items()})
    image = renderer.image(name)
    assert len(red_pixels(np.asarray(image))) > 50, "the red cube is not in the picture"
    PICTURES.mkdir(parents=True, exist_ok=True)
    path = PICTURES / f"physics_{name}.png"
    Image.fromarray(image).quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size <= MAX_BYTES
    with Image.open(ROOT / f"docs/pictures/{path.name}") as shown:
        assert shown.size == (width, height), "make pictures"
