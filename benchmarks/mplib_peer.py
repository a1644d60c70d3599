"""Plan with MPlib, in an interpreter of its own: ``python mplib_peer.py PROBLEM.json URDF SRDF TIP RRT_RANGE``.

Prints a line of JSON for each joint problem: CPU seconds, and the motion as ``armbridge plan --json`` writes it or the
reason of the failure. Imports nothing of armbridge: MPlib needs numpy below 2.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from mplib import Planner, Pose
from mplib.collision_detection import fcl

# The same density of samples as armbridge's motions, with which these are compared.
TIME_STEP_S = 0.01
PLANNING_TIME_S = 2.0

BASE = "base_link"


def main(problem_path: str, urdf: str, srdf: str, tip: str, rrt_range: str) -> None:
    """Plan the joint problems of a file."""
    fields = json.loads(Path(problem_path).read_text())
    limits = fields["limits"]
    planner = Planner(
        urdf,
        tip,
        srdf=srdf,
        use_convex=True,
        joint_vel_limits=limits["velocity"],
        joint_acc_limits=limits["acceleration"],
    )
    _set_scene(planner, fields)
    names = planner.user_joint_names
    for problem in fields["joint_problems"]:
        start, goal = (_full(names, fields, problem[key]) for key in ("start", "goal"))
        started_s = time.process_time()
        answer = planner.plan_qpos(
            [goal], start, time_step=TIME_STEP_S, rrt_range=float(rrt_range), planning_time=PLANNING_TIME_S
        )
        outcome = {"cpu_s": time.process_time() - started_s, **_motion(answer)}
        sys.stdout.write(f"\n@{json.dumps({'problem': problem['id'], **outcome})}\n")


def _full(names: list[str], fields: dict[str, Any], point: list[float]) -> Any:
    """Return a configuration of every joint."""
    positions = dict(zip(fields["joint_names"], point, strict=True)) | {"gripper": fields["gripper"]}
    return np.array([positions[name] for name in names])


def _motion(answer: dict[str, Any]) -> dict[str, Any]:
    if answer["status"] != "Success":
        return {"message": answer["status"]}
    return {
        "time_from_start": answer["time"].tolist(),
        "positions": answer["position"].tolist(),
        "velocities": answer["velocity"].tolist(),
        "accelerations": answer["acceleration"].tolist(),
    }


def _set_scene(planner: Planner, fields: dict[str, Any]) -> None:
    world, allowed = planner.planning_world, planner.acm
    for thing in fields["objects"]:
        shape = fcl.CollisionObject(_geometry(thing))
        world.add_object(fcl.FCLObject(thing["id"], _pose(thing), [shape], [Pose()]))
        # Both stand still.
        allowed.set_entry(BASE, thing["id"], True)
    robot = planner.robot.get_name()
    for thing in fields["attached"]:
        link = planner.link_name_2_idx[thing["link"]]
        touching = [thing["link"], *thing["touch_links"]]
        world.attach_object(thing["id"], _geometry(thing), robot, link, _pose(thing), touching)


def _pose(thing: dict[str, Any]) -> Pose:
    x, y, z, w = thing["pose"]["orientation"]
    return Pose(np.array(thing["pose"]["position"], dtype=float), np.array([w, x, y, z]))


def _geometry(thing: dict[str, Any]) -> Any:
    size = thing.get("dimensions", [])
    if thing["type"] == "box":
        return fcl.Box(size)
    if thing["type"] == "sphere":
        return fcl.Sphere(size[0])
    if thing["type"] == "cylinder":
        return fcl.Cylinder(size[1], size[0])
    if thing["type"] == "cone":
        return fcl.Cone(size[1], size[0])
    mesh = fcl.BVHModel()
    mesh.begin_model(len(thing["triangles"]), len(thing["vertices"]))
    vertices = [np.array(vertex, dtype=float) for vertex in thing["vertices"]]
    mesh.add_sub_model(vertices, [fcl.Triangle(*triangle) for triangle in thing["triangles"]])
    mesh.end_model()
    return mesh


if __name__ == "__main__":
    main(*sys.argv[1:])
