"""What a fabrication researcher does with compas_fab, step by step; prints one JSON object: step -> what came back.

Usage: python compas_fab_scenario.py URL, as ws://127.0.0.1:9090/ or, for a robot that runs ROS 1, with ?ros=1
"""

import json
import sys
import threading
from collections.abc import Callable
from typing import Any

from compas.datastructures import Mesh
from compas.geometry import Box, Frame, Vector
from compas_fab.backends import MoveItPlanner, RosClient
from compas_fab.backends.exceptions import CollisionCheckError
from compas_fab.robots import ConfigurationTarget, FrameTarget, FrameWaypoints, RigidBody, TargetMode

STEP_TIMEOUT_S = 120.0
GROUP = "arm"

# Bent forward, the tip some 20 cm before the base; and a quarter turn aside.
READY = {"shoulder_pan": 0.0, "shoulder_lift": -0.6, "elbow_flex": 0.9, "wrist_flex": 0.3, "wrist_roll": 0.0}
ASIDE = {**READY, "shoulder_pan": 0.6}


class Fabrication:
    """One session with the robot."""

    def __init__(self, url: str) -> None:
        self.client = RosClient(url, None)
        self.client.run(STEP_TIMEOUT_S)
        self.cell = self.client.load_robot_cell(load_geometry=True)
        self.planner = MoveItPlanner(self.client)
        self.heard: dict[str, Any] = {
            "distro": str(self.client.ros_distro.value),
            "robot": self.cell.robot_model.name,
            "links": len(list(self.cell.robot_model.links)),
            "group joints": self.cell.get_configurable_joint_names(GROUP),
        }

    def state(self, positions: dict[str, float]) -> Any:
        """The cell with the robot in a configuration."""
        state = self.cell.default_cell_state()
        for name, value in positions.items():
            state.robot_configuration[name] = value
        return state

    def carry_out(self) -> None:
        """Every step, in the order of a day's work."""
        ready = self.state(READY)
        frame = self.planner.forward_kinematics(ready, TargetMode.ROBOT, GROUP)
        self.heard["tip"] = list(frame.point)
        target = FrameTarget(frame, TargetMode.ROBOT)
        found = self.planner.inverse_kinematics(target, ready, GROUP, {"max_results": 1})
        self.heard["inverse kinematics"] = {name: found[name] for name in READY}
        self._plan(ready)
        self._plan_line(ready)
        self._with_a_box()

    def _plan(self, ready: Any) -> None:
        aside = self.state(ASIDE).robot_configuration
        target = ConfigurationTarget(aside, [0.001] * 6, [0.001] * 6)
        motion = self.planner.plan_motion(target, ready, GROUP)
        self.heard["planned"] = {"fraction": motion.fraction, "points": len(motion.points)}
        end = motion.points[-1]
        self.heard["planned end"] = {name: end[name] for name in READY}
        self.heard["planning time"] = motion.planning_time

    def _plan_line(self, ready: Any) -> None:
        frame = self.planner.forward_kinematics(ready, TargetMode.ROBOT, GROUP)
        near = Frame(frame.point + Vector(0.0, 0.0, 0.02), frame.xaxis, frame.yaxis)
        line = self.planner.plan_cartesian_motion(FrameWaypoints([near], TargetMode.ROBOT), ready, GROUP)
        self.heard["line"] = {"fraction": line.fraction, "points": len(line.points)}

    def _with_a_box(self) -> None:
        box = Mesh.from_shape(Box(0.08))
        self.cell.rigid_body_models["box"] = RigidBody.from_mesh(box)
        state = self.state(READY)
        state.rigid_body_states["box"].frame = Frame([0.5, 0.5, 0.2], [1, 0, 0], [0, 1, 0])
        self.planner.set_robot_cell(self.cell, state)
        self.heard["scene with the box"] = self._objects()
        self.planner.check_collision(state, {"group": GROUP})
        tip = self.planner.forward_kinematics(state, TargetMode.ROBOT, GROUP)
        state.rigid_body_states["box"].frame = Frame(tip.point, [1, 0, 0], [0, 1, 0])
        try:
            self.planner.check_collision(state, {"group": GROUP})
        except CollisionCheckError as error:
            self.heard["collision"] = [sorted(pair) for pair in error.collision_pairs]
        self._attach(state)
        del self.cell.rigid_body_models["box"]
        self.planner.set_robot_cell(self.cell, self.state(READY))
        self.heard["scene without the box"] = self._objects()

    def _attach(self, state: Any) -> None:
        held = state.rigid_body_states["box"]
        held.frame = None
        held.attached_to_link = "gripper_link"
        held.attachment_frame = Frame([0.0, 0.0, -0.15], [1, 0, 0], [0, 1, 0])
        held.touch_links = ["gripper_link", "moving_jaw_so101_v1_link", "wrist_link"]
        self.planner.set_robot_cell_state(state)
        scene = self.planner.get_planning_scene()
        self.heard["held"] = [held.object["id"] for held in scene.robot_state.attached_collision_objects]
        target = ConfigurationTarget(self.state(ASIDE).robot_configuration, [0.001] * 6, [0.001] * 6)
        self.heard["planned with the box"] = self.planner.plan_motion(target, state, GROUP).fraction

    def execute(self) -> None:
        """Move the robot: plan from where it is, and have the motion executed by either action."""
        here = dict.fromkeys(READY, 0.0)
        there = ConfigurationTarget(self.state(READY).robot_configuration, [0.001] * 6, [0.001] * 6)
        motion = self.planner.plan_motion(there, self.state(here), GROUP)
        self.heard["executed"] = self._done(lambda **hooks: self.client.execute_joint_trajectory(motion, **hooks))
        back = ConfigurationTarget(self.state(here).robot_configuration, [0.001] * 6, [0.001] * 6)
        motion = self.planner.plan_motion(back, self.state(READY), GROUP)
        self.heard["followed"] = self._done(lambda **hooks: self.client.follow_joint_trajectory(motion, **hooks))

    def _done(self, start: Callable[..., Any]) -> str:
        """How an action ended, in a word."""
        ended, answers = threading.Event(), list[str]()

        def end(word: str) -> None:
            answers.append(word)
            ended.set()

        start(callback=lambda _result: end("done"), errback=lambda error: end(f"failed: {error}"))
        ended.wait(STEP_TIMEOUT_S)
        return answers[0] if answers else "no answer"

    def _objects(self) -> list[str]:
        return [thing.id for thing in self.planner.get_planning_scene().world.collision_objects]


def main(url: str) -> None:
    """Run the session and print what was heard."""
    fabrication = Fabrication(url)
    fabrication.carry_out()
    # Its ROS 2 client never hears of the end of an action: it looks for the result's fields beside its envelope.
    if "?ros=1" in url:
        fabrication.execute()
    print(json.dumps(fabrication.heard))
    fabrication.client.terminate()


if __name__ == "__main__":
    main(sys.argv[1])
