import numpy as np

from planners.geometry.forward import ForwardKinematics


def test_links_are_where_collision_checks_have_them(robot, collision):
    forward = ForwardKinematics(robot, collision.joint_names)
    for q in np.random.default_rng(2).uniform(collision.lower_rad, collision.upper_rad, (10, 6)):
        forward.place(q)
        for link in robot.links:
            np.testing.assert_allclose(
                forward.placement(link).translation, collision.tip_positions([q], link)[0], atol=1e-12
            )


def test_joints_may_come_in_any_order(robot, collision):
    names = collision.joint_names
    forward, backward = ForwardKinematics(robot, names), ForwardKinematics(robot, names[::-1])
    q = np.linspace(-0.5, 0.5, 6)
    forward.place(q)
    backward.place(q[::-1])
    for link in robot.links:
        np.testing.assert_array_equal(forward.placement(link).homogeneous, backward.placement(link).homogeneous)


def test_many_placements_are_those_one_by_one(robot, collision):
    forward = ForwardKinematics(robot, collision.joint_names)
    states = np.random.default_rng(3).uniform(collision.lower_rad, collision.upper_rad, (5, 6))
    placements = forward.placements(states, "gripper_link")
    for i, q in enumerate(states):
        forward.place(q)
        np.testing.assert_array_equal(placements.rotations[i], forward.placement("gripper_link").rotation)
        np.testing.assert_array_equal(placements.positions_m[i], forward.placement("gripper_link").translation)


def test_jacobian_is_the_derivative_of_the_position(robot, collision):
    forward = ForwardKinematics(robot, collision.joint_names)
    q, step = np.array([0.3, -0.4, 0.5, 0.2, -0.6, 0.1]), 1e-6
    jacobian = forward.jacobian(q, "gripper_frame_link")
    for joint in range(6):
        moved = q + step * np.eye(6)[joint]
        difference_m = (
            collision.tip_positions([moved], "gripper_frame_link")[0]
            - collision.tip_positions([q], "gripper_frame_link")[0]
        )
        np.testing.assert_allclose(jacobian[:3, joint], difference_m / step, atol=1e-5)
