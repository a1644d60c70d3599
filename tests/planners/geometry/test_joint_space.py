"""Forward kinematics and the space of joints."""

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.certificate import line_free
from planners.geometry.collision import CollisionModel
from planners.geometry.joint_space import CONDITION_STEP_M, JointSpace
from planners.geometry.kinematics import ForwardKinematics, Reach
from planners.geometry.shapes import kinematic_urdf, outline, robot_shapes
from planners.scene import Box, Pose, SceneObject
from robot.description import model
from tests.helpers.robots import so101
from tests.planners.invariants import BLOCKED_LINES
from tests.planners.scenes import around_the_arm, scene, thing, tip_positions_m
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF

CRANE = model.parse(CRANE_URDF, CRANE_SRDF)


def test_limits_are_those_of_the_model_and_continuous_joints_get_one_turn_either_way(robot):
    elbow = dataclasses.replace(robot.joints["elbow_flex"], lower=-0.5, upper=0.25)
    narrow = dataclasses.replace(robot, joints={**robot.joints, "elbow_flex": elbow})
    for placed_arm, joint, limits in ((narrow, "elbow_flex", (-0.5, 0.25)), (CRANE, "turn", (-math.pi, math.pi))):
        kinematics = pin.buildModelFromXML(kinematic_urdf(placed_arm))
        assert kinematics.nq == kinematics.nv == len(placed_arm.movable_joints)
        column = kinematics.joints[kinematics.getJointId(joint)].idx_q
        found = kinematics.lowerPositionLimit[column], kinematics.upperPositionLimit[column]
        assert found == pytest.approx(limits)


def test_joints_may_come_in_any_order_and_those_of_a_group_need_not_stand_in_a_row(robot, collision):
    names = collision.joint_names
    forward, backward = ForwardKinematics(robot, names), ForwardKinematics(robot, names[::-1])
    q = np.linspace(-0.5, 0.5, 6)
    forward.place(q)
    backward.place(q[::-1])
    for link in robot.links:
        np.testing.assert_array_equal(forward.placement(link).homogeneous, backward.placement(link).homogeneous)
    ends = '<group name="ends"><joint name="turn"/><joint name="slide"/></group></robot>'
    crane = model.parse(CRANE_URDF, CRANE_SRDF.replace("</robot>", ends))
    collision = CollisionModel(crane)
    space = JointSpace(collision, crane.groups["ends"].joints, np.array([0.0, 0.3, 0.0]))
    assert collision.joint_names == ("turn", "lift", "slide")
    assert len(space.point(np.zeros(3))) == 2
    assert line_free(space, np.array([0.0, 0.0]), np.array([1.0, 0.1]))


class Arm:
    """Positions of all points of an arm's shapes."""

    def __init__(self, robot_model):
        self.robot = robot_model
        self.model = pin.buildModelFromXML(kinematic_urdf(robot_model))
        self.shapes = robot_shapes(robot_model, self.model)
        self.reach = Reach(self.model)
        self._data = self.model.createData()
        self._outlines = [(shape.parentJoint, outline(shape)) for shape in self.shapes]

    def points(self, q):
        """Of each shape, shape (n, 3) [m]."""
        pin.forwardKinematics(self.model, self._data, q)
        return [points @ self._data.oMi[j].rotation.T + self._data.oMi[j].translation for j, points in self._outlines]

    def frames(self, q):
        """Positions of all frames [m]."""
        pin.forwardKinematics(self.model, self._data, q)
        count = len(self.model.frames)
        return np.array([pin.updateFramePlacement(self.model, self._data, i).translation.copy() for i in range(count)])

    def moves(self, seed, count, widest_rad):
        """Configurations and what is added to each."""
        rng = np.random.default_rng(seed)
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        for _ in range(count):
            q = rng.uniform(lower, upper)
            dq = rng.uniform(-widest_rad, widest_rad, len(q)) * rng.integers(0, 2, len(q))
            yield q, np.clip(q + dq, lower, upper) - q


@pytest.fixture(params=[so101(), CRANE], ids=["so101", "crane"])
def placed_arm(request):
    return Arm(request.param)


def test_no_point_of_a_shape_and_no_frame_moves_further_than_the_bound_or_is_further_from_the_root(placed_arm):
    reach_m, frames_reach_m = placed_arm.reach.of_shapes(placed_arm.shapes), placed_arm.reach.of_frames()
    farthest_m = max(placed_arm.reach.farthest_m(shape) for shape in placed_arm.shapes)
    for q, dq in placed_arm.moves(2, 300, 0.2):
        points_m = placed_arm.points(q)
        assert np.linalg.norm(np.vstack(points_m), axis=1).max() <= farthest_m
        for before, after, bound_m in zip(points_m, placed_arm.points(q + dq), reach_m @ np.abs(dq), strict=True):
            assert np.linalg.norm(after - before, axis=1).max() <= bound_m + 1e-12
        moved_m = np.linalg.norm(placed_arm.frames(q + dq) - placed_arm.frames(q), axis=1)
        assert np.all(moved_m <= frames_reach_m @ np.abs(dq) + 1e-12)


def test_no_pair_comes_nearer_than_the_bound(placed_arm):
    collision = CollisionModel(placed_arm.robot)
    collision.set_scene(around_the_arm(5))
    broadphase, pairs = collision._broadphase, range(len(collision._names))
    for q, dq in placed_arm.moves(6, 100, 0.1):
        distances_m = []
        for state in (q, q + dq):
            broadphase.place(state)
            distances_m.append(np.array([broadphase.distance_m(pair) for pair in pairs]))
        apart = distances_m[1] > 0.0
        margins_m = collision.approach_m_per_rad @ np.abs(dq)
        assert np.all((distances_m[0] - distances_m[1] <= margins_m + 1e-6)[apart])


HOME, TURNED = np.zeros(5), np.array([1.0, 0.0, 0.0, 0.0, 0.0])


def test_lines_through_the_arm_are_blocked_from_either_side(joint_space):
    for start, end in BLOCKED_LINES:
        assert not line_free(joint_space, np.array(start), np.array(end))
        assert not line_free(joint_space, np.array(end), np.array(start))


def test_a_pair_has_the_same_clearance_looked_at_alone_and_keeps_what_the_joints_cannot_use_up(space_in):
    space, rng, seen = space_in(around_the_arm(1)), np.random.default_rng(0), 0
    margins_m = np.full(len(space.approach_m_per_rad), 0.1)
    for _ in range(50):
        point = rng.uniform(0.5 * space.lower_rad, 0.5 * space.upper_rad)
        step = rng.uniform(-0.05, 0.05, 5)
        near = space.near(point, margins_m)
        assert space.free(point) == all(clearance_m > 0.0 for _, clearance_m in near)
        for pair, clearance_m in near:
            assert space.clearance_m(pair, point, 0.1) == pytest.approx(clearance_m, abs=1e-6)
            least_m = clearance_m - space.approach_m_per_rad[pair] @ np.abs(step)
            if clearance_m > 0.0:
                seen += 1
                assert space.clearance_m(pair, point + step, 0.1) >= least_m - 1e-6
    assert seen > 50


def test_a_condition_is_asked_all_along_a_line_which_is_not_free_if_it_leaves_the_condition(collision, arm):
    asked = []
    space = JointSpace(collision, arm.joints, np.zeros(6), holds=lambda q: asked.append(q[0]) is None)
    assert line_free(space, HOME, TURNED)
    steps_m = np.diff(np.sort(asked)) * collision.travel_m_per_rad[0]
    assert steps_m.max() <= 2.0 * CONDITION_STEP_M
    space = JointSpace(collision, arm.joints, np.zeros(6), holds=lambda q: not 0.4 < q[0] < 0.45)
    assert [space.free(point) for point in (HOME, TURNED, 0.42 * TURNED)] == [True, True, False]
    assert not line_free(space, HOME, TURNED)


def test_a_motion_may_leave_an_allowed_contact_but_not_deepen_it(space_in, changing, arm):
    assert not space_in(scene(thing(Box((0.1, 0.1, 0.1)), 0.38, 0.0, 0.16))).free(HOME)
    contacts = {pair.links: pair.depth_m for pair in changing.colliding_pairs(np.zeros(6))}
    assert contacts
    space = JointSpace(changing, arm.joints, np.zeros(6), contacts)
    assert space.free(HOME)
    up, down = HOME + np.array([0.0, -0.4, 0.0, 0.0, 0.0]), HOME + np.array([0.0, 0.05, 0.0, 0.0, 0.0])
    assert line_free(space, HOME, up)
    assert not line_free(space, HOME, down)
    assert space.contacts(down)
    # So may an arm without meshes, which begins elsewhere.
    collision = CollisionModel(CRANE)
    collision.set_scene(scene(thing(Box((0.1, 0.1, 0.1)), 0.0, 0.2, 0.215)))
    start = np.array([0.5 * np.pi, 0.0, 0.0])
    space = JointSpace(collision, CRANE.groups["arm"].joints, start, collision.overlaps_m(start))
    assert space.free(start)
    assert not space.contacts(start)
    # The margin is far wider than the clearance, and no parts are known that could be further apart.
    ((_, clearance_m),) = space.near(start, np.full(len(space.approach_m_per_rad), 0.05))
    assert 0.0 < clearance_m < 0.001
    assert line_free(space, start, start + np.array([0.0, -0.5, 0.0]))
    assert not line_free(space, start, start + np.array([0.0, 0.3, 0.0]))


def test_an_allowed_contact_does_not_come_again_further_on(changing, arm):
    # Two posts of one object: a turn of the base alone brings the arm as deep into the second as it is in the first.
    axis_m = tip_positions_m(changing, [np.zeros(6)], "shoulder_link")[0][:2]

    def post(pan_rad):
        x, y = axis_m + 0.35 * np.array([np.cos(pan_rad), np.sin(pan_rad)])
        return Pose((x, y, 0.16), (0.0, 0.0, float(np.sin(pan_rad / 2.0)), float(np.cos(pan_rad / 2.0))))

    posts = tuple((Box((0.1, 0.1, 0.1)), post(pan_rad)) for pan_rad in (0.0, -TURNED[0]))
    changing.set_scene(scene(SceneObject("posts", posts, Pose())))
    q, there = np.zeros(6), np.append(TURNED, 0.0)
    overlaps_m = changing.overlaps_m(q)
    assert overlaps_m
    assert overlaps_m == pytest.approx(changing.overlaps_m(there), abs=1e-4)
    assert not changing.in_collision(there, frozenset(changing.pairs_of(overlaps_m)), overlaps_m)
    space = JointSpace(changing, arm.joints, q, overlaps_m)
    assert space.free(HOME)
    assert not space.free(TURNED)
    assert any(
        clearance_m <= 0.0 for _, clearance_m in space.near(TURNED, np.full(len(space.approach_m_per_rad), 0.01))
    )
