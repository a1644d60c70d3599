"""Plan as roboplan or MPlib, in an interpreter that has it: ``planning_peer.py PEER PROBLEMS.json ANSWERS.json``.

Imports nothing of armbridge. ``planning_passages.py`` writes the problems; an answer is the CPU time of the plan and
the positions of the motion, a sample every hundredth of a second, or None.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

PERIOD_S = 0.01
# The peers' limits are of wall time; the benchmark counts what is solved by CPU time.
ALLOWED_TIME_S = 20.0
MOST_NODES = 1_000_000

Fields = dict[str, Any]
Answers = Iterator[tuple[float, list[list[float]] | None]]


def roboplan(arm: Fields, problems: list[Fields], step_rad: float) -> Answers:
    """RRT-Connect, shortcuts and TOPP-RA; ``step_rad`` is the distance of its checks along an edge."""
    core, rrt, toppra = (import_module(f"roboplan.{part}") for part in ("core", "rrt", "toppra"))
    limits = zip(arm["joints"], arm["velocity"], arm["acceleration"], strict=True)
    config = {name: {"max_velocity": [fast], "max_acceleration": [gain]} for name, fast, gain in limits}
    scene = core.Scene("arm", core.loadUrdfSceneDescriptionFromXml(arm["urdf"]))
    scene.importSrdf(arm["srdf"])
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        json.dump({"joint_limits": config}, file)
        file.flush()
        scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(file.name))
    names: list[str] = []
    for problem in problems:
        for name in names:
            scene.removeGeometry(name)
        names = []
        for thing in problem["things"]:
            name, kind = f"thing{len(names)}", "Box" if len(thing["size"]) == 3 else "Cylinder"
            shape, placement = getattr(core, kind)(*thing["size"]), np.array(thing["placement"], order="F")
            getattr(scene, f"add{kind}Geometry")(name, "universe", shape, placement, np.ones(4))
            for still in (*arm["standing"], *names):
                scene.setCollisions(still, name, False)
            names.append(name)
        options = rrt.RRTOptions("arm", MOST_NODES, rrt_connect=True, max_planning_time=ALLOWED_TIME_S)
        options.collision_check_step_size = step_rad
        planner = rrt.RRT(scene, options)
        planner.setRngSeed(problem["seed"])
        shortcuts = core.PathShortcutter(scene, core.PathShortcuttingOptions("arm", step_rad, seed=problem["seed"]))
        timing, timed = toppra.PathParameterizerTOPPRA(scene, "arm"), toppra.TOPPRAOptions(PERIOD_S)
        start, goal = (core.JointConfiguration(arm["joints"], np.array(problem[end])) for end in ("start", "goal"))
        motion, started_s = None, time.process_time()
        try:
            motion = timing.generate(shortcuts.shortcut(planner.plan(start, goal)), timed)
        except RuntimeError as error:
            print(error)
        yield time.process_time() - started_s, motion and [point.tolist() for point in motion.positions]


def mplib(arm: Fields, problems: list[Fields]) -> Answers:
    """RRT-Connect of OMPL with its own simplification, and TOPP-RA."""
    library, fcl = import_module("mplib"), import_module("mplib.collision_detection.fcl")
    with tempfile.TemporaryDirectory() as folder:
        # Each mesh's name is taken for a path below the URDF's folder.
        Path(folder, "root").symlink_to("/")
        urdf, srdf = Path(folder, "arm.urdf"), Path(folder, "arm.srdf")
        urdf.write_text(arm["urdf"].replace('filename="/', 'filename="root/'))
        srdf.write_text(arm["srdf"])
        limits = {"joint_vel_limits": arm["velocity"], "joint_acc_limits": arm["acceleration"]}
        planner = library.Planner(urdf, arm["tip"], srdf=srdf, **limits)
    world = planner.planning_world
    for problem in problems:
        for name in world.get_object_names():
            world.remove_object(name)
        for number, thing in enumerate(problem["things"]):
            name, size = f"thing{number}", thing["size"]
            shape = fcl.CollisionObject(fcl.Box(size) if len(size) == 3 else fcl.Cylinder(*size))
            world.add_object(fcl.FCLObject(name, library.Pose(np.array(thing["placement"])), [shape], [library.Pose()]))
            for link in arm["standing"]:
                planner.acm.set_entry(link, name, True)
        started_s = time.process_time()
        answer = planner.plan_qpos(
            [np.array(problem["goal"])],
            np.array(problem["start"]),
            time_step=PERIOD_S,
            planning_time=ALLOWED_TIME_S,
        )
        solved = answer["status"] == "Success"
        print(answer["status"])
        yield time.process_time() - started_s, answer["position"].tolist() if solved else None


PEERS: dict[str, Callable[[Fields, list[Fields]], Answers]] = {
    "roboplan, 0.05 rad": partial(roboplan, step_rad=0.05),
    "roboplan, 0.01 rad": partial(roboplan, step_rad=0.01),
    "MPlib": mplib,
}

if __name__ == "__main__":
    fields = json.loads(Path(sys.argv[2]).read_text())
    Path(sys.argv[3]).write_text(json.dumps(list(PEERS[sys.argv[1]](fields["arm"], fields["problems"]))))
