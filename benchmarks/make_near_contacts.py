"""Draw goals next to obstacles: ``python -m benchmarks.make_near_contacts`` writes ``scenes/near_contacts.json``.

In each goal the arm's hulls touch something. The official meshes touch something in one half: these goals must be
refused. The other half is free by the arm's parts, and so is a straight line to each goal by the meshes. Needs the
reference data beside the checkout.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from benchmarks.make_scenes import GRIPPER_RAD, JOINTS, LIMITS, SCENES, Vector
from benchmarks.scene_things import near_contacts
from harness.full_meshes import Judge
from harness.server import REFERENCE
from planners.files import problem_file
from planners.geometry.collision import CollisionModel
from robot.description.robot_folder import built_in

NAME = "near_contacts"
SEED = 21

# Goals that parts and meshes accept, and those that touch.
FREE, TOUCHING = 100, 100

# A start this far away, in a random direction, is mostly out of the narrow place [rad].
AWAY_RAD = 0.25

# Contacts this shallow in the hulls are near ones [m].
SHALLOW_M = 0.008

# Points of the line to a free goal that are judged: no point of the arm moves a millimetre between two.
LINE_POINTS = 300


def main() -> None:
    """Write the file."""
    fields = {
        "format": "so101-plan-bench/1",
        "name": NAME,
        "description": "goals in which the arm's hulls touch something, next to pillars and a table",
        "frame": "base_link",
        "joint_names": JOINTS,
        "gripper": GRIPPER_RAD,
        "limits": LIMITS,
        "objects": near_contacts(),
        "attached": [],
    }
    path = SCENES / f"{NAME}.json"
    path.write_text(json.dumps({**fields, "joint_problems": [], "position_problems": [], "infeasible": []}))
    robot = built_in("so101").model
    collision = CollisionModel(robot)
    collision.set_scene(problem_file.read(path, robot).scene)
    judge = Judge(REFERENCE, fields)
    rng = np.random.default_rng(SEED)
    wanted = {"free": FREE, "touching": TOUCHING}
    found: dict[str, list[tuple[Vector, Vector]]] = {kind: [] for kind in wanted}
    for kind, start, goal in _drawn(collision, judge, rng):
        if len(found[kind]) < wanted[kind]:
            found[kind].append((start, goal))
        if all(len(found[kind]) >= count for kind, count in wanted.items()):
            break
    free = [
        {"id": f"{NAME}-j{i:03}", "start": start.tolist(), "goal": goal.tolist()}
        for i, (start, goal) in enumerate(found["free"])
    ]
    touching = [
        {
            "id": f"{NAME}-x{i:03}",
            "kind": "goal_in_collision",
            "accept_codes": [-12],
            "start": start.tolist(),
            "goal": goal.tolist(),
        }
        for i, (start, goal) in enumerate(found["touching"])
    ]
    path.write_text(
        json.dumps({**fields, "joint_problems": free, "position_problems": [], "infeasible": touching}) + "\n"
    )
    print(f"{path.name}: {len(free)} free goals, {len(touching)} that touch")


def _drawn(collision: CollisionModel, judge: Judge, rng: np.random.Generator) -> Iterator[tuple[str, Vector, Vector]]:
    """Yield the kind of a goal, a start and the goal, without an end."""
    lower, upper = np.array(LIMITS["lower"]), np.array(LIMITS["upper"])
    order = [collision.joint_names.index(name) for name in JOINTS]
    q = np.zeros(len(collision.joint_names))
    q[collision.joint_names.index("gripper")] = GRIPPER_RAD
    while True:
        goal: Vector = rng.uniform(lower, upper).round(6)
        q[order] = goal
        if not collision.in_collision(q) or collision.colliding_pairs(q, {})[0].depth_m > SHALLOW_M:
            continue
        away = rng.normal(size=len(JOINTS))
        start: Vector = np.clip(goal + AWAY_RAD * away / np.linalg.norm(away), lower, upper).round(6)
        q[order] = start
        if judge.collides(start) or collision.in_collision(q):
            continue
        if judge.collides(goal):
            yield "touching", start, goal
        elif not any(judge.collides(point) for point in np.linspace(start, goal, LINE_POINTS)):
            q[order] = goal
            if not collision.collides(q):
                yield "free", start, goal


if __name__ == "__main__":
    main()
