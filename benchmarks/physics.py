"""Physics and rendering of the SO-101 with ten objects: CPU time of a control tick and of an image."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np

from harness.figures import print_table
from robot.description import robot_folder
from robot.physics.bodies import Body, BodyShape, SetBodies

OBJECTS, TICK_S = 10, 0.01


def run() -> None:
    """Print the table; shares of a core are those of 100 ticks and of a camera's images a second."""
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported
    from robot.physics.renderer import ArmRenderer
    from robot.physics.world import World

    folder = robot_folder.built_in("so101")
    names = [joint.name for joint in folder.model.movable_joints]
    shape = BodyShape("box", (0.0125,) * 3, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    at_m = [(0.25 + 0.04 * (number % 2), 0.06 * (number // 2 - 2), 0.0125) for number in range(OBJECTS)]
    bodies = tuple(Body(str(at), (shape,), at, (0.0, 0.0, 0.0, 1.0), movable=True) for at in at_m)
    world = World(folder.model, names, np.zeros(len(names)))
    cameras = ArmRenderer(folder.model, folder.cameras)
    cameras.set_bodies(bodies, {})
    world.set_bodies(SetBodies(1, bodies))
    damping, image_hz = np.ones(len(names)), folder.cameras["front"].rate_hz
    parts: list[tuple[str, float, Callable[[], object]]] = [
        ("tick", 1.0 / TICK_S, lambda: world.advance(TICK_S, lambda: world.push(world.load_nm, damping))),
        ("image", image_hz, lambda: cameras.image("front")),
        ("depth image", image_hz, lambda: cameras.depth_m("front")),
    ]
    rows = []
    for name, rate_hz, work in parts:
        began_s, count = time.process_time(), 0
        while (spent_s := time.process_time() - began_s) < 1.0:
            work()
            count += 1
        rows.append([name, f"{rate_hz:g}", f"{1e3 * spent_s / count:.2f}", f"{100 * rate_hz * spent_s / count:.0f}"])
    print_table("Physics and rendering, ten objects", ["part", "rate [Hz]", "CPU [ms]", "of a core [%]"], rows)
