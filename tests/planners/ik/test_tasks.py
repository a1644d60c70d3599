import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import placo
import pytest

from planners.ik.conditions import AxisCondition, JointCondition, PointCondition, TurnCondition
from planners.ik.tasks import MAX_POINTS, MAX_STEP_M, AxisTask, JointTask, link_task, slides, with_targets

TIP = "gripper_frame_link"


@pytest.fixture(scope="module")
def wrapper(robot):
    return placo.RobotWrapper("", placo.Flags.ignore_collisions, with_targets(robot))


@pytest.fixture
def solver(wrapper):
    wrapper.reset()
    solver = wrapper.make_solver()
    solver.mask_fbase(True)
    for name in slides():
        solver.mask_dof(name)
    solver.add_regularization_task(1e-6)
    return solver


def placement(wrapper):
    wrapper.update_kinematics()
    matrix = wrapper.get_T_world_frame(TIP)
    return pin.SE3(matrix[:3, :3], matrix[:3, 3])


def follow(wrapper, solver, task, steps=30):
    """What is missing before, and after some steps."""
    first = task.aim(placement(wrapper), 0.0)
    for _ in range(steps):
        last = task.aim(placement(wrapper), 0.0)
        wrapper.update_kinematics()
        solver.solve(True)
    return first, last


CONDITIONS = {
    "point": PointCondition(TIP, np.array([0.02, 0.0, 0.01]), np.array([0.3, 0.1, 0.15]), np.eye(3), 0.01),
    "turn": TurnCondition(TIP, pin.exp3(np.array([0.0, 1.2, 0.0])), np.full(3, 0.1)),
    "axis": AxisCondition(TIP, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0]), 0.1),
}


@pytest.mark.parametrize("kind", ["point", "axis"])
def test_steps_lead_to_where_the_condition_holds(wrapper, solver, kind):
    first, last = follow(wrapper, solver, link_task(wrapper, solver, CONDITIONS[kind], 1.0, 0))
    assert first > 0.05
    assert last < 1e-4


def test_turn_is_reached_as_far_as_five_joints_can(wrapper, solver):
    first, last = follow(wrapper, solver, link_task(wrapper, solver, CONDITIONS["turn"], 1.0, 0))
    assert last < 0.5 * first


def test_axis_that_is_reached_stays_finite(wrapper, solver):
    task = AxisTask(solver, CONDITIONS["axis"], 1.0, 0)
    follow(wrapper, solver, task, steps=60)
    assert np.all(np.isfinite(wrapper.state.q))


def test_joint_is_moved_into_its_range(wrapper, solver):
    task = JointTask(solver, JointCondition("elbow_flex", 2, 0.4, 0.3, 0.5), 1.0, 0)
    for _ in range(5):
        task.aim(float(wrapper.state.q[wrapper.get_joint_offset("elbow_flex")]), 0.0)
        wrapper.update_kinematics()
        solver.solve(True)
    assert wrapper.state.q[wrapper.get_joint_offset("elbow_flex")] == pytest.approx(0.4, abs=1e-4)


def test_what_is_missing_is_weighted(wrapper, solver):
    here = placement(wrapper)
    heavy, light = (link_task(wrapper, solver, CONDITIONS["point"], weight, 0) for weight in (4.0, 1.0))
    assert heavy.aim(here, 0.0) == pytest.approx(2.0 * light.aim(here, 0.0))


def test_condition_that_holds_does_not_hinder_another(wrapper, solver):
    here = placement(wrapper)
    anywhere = PointCondition(TIP, np.zeros(3), here.translation, np.eye(3), 0.5)
    point = link_task(wrapper, solver, anywhere, 1.0, 0)
    joint = JointTask(solver, JointCondition("shoulder_pan", 0, 0.5, 0.4, 0.6), 1.0, 1)
    column = wrapper.get_joint_offset("shoulder_pan")
    for _ in range(3):
        point.aim(placement(wrapper), 0.9)
        joint.aim(float(wrapper.state.q[column]), 0.9)
        wrapper.update_kinematics()
        solver.solve(True)
    assert wrapper.state.q[column] > 0.35


def test_far_targets_are_approached_in_steps(wrapper, solver):
    far = PointCondition(TIP, np.zeros(3), np.array([5.0, 0.0, 0.0]), np.eye(3), 0.01)
    here = placement(wrapper)
    link_task(wrapper, solver, far, 1.0, 0).aim(here, 0.0)
    target_m = wrapper.state.q[[wrapper.get_joint_offset(name) for name in slides()[:3]]]
    assert np.linalg.norm(target_m - here.translation) == pytest.approx(MAX_STEP_M)


def test_targets_are_slides_that_no_link_of_the_robot_hangs_on(robot):
    root = ET.fromstring(with_targets(robot))
    joints = {joint.get("name"): joint for joint in root.iterfind("joint")}
    assert len(slides()) == 3 * MAX_POINTS
    assert all(joints[name].get("type") == "prismatic" for name in slides())
    children = {joints[name].find("child").get("link") for name in slides()}
    assert not children & set(robot.links)
