import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.scene import Pose
from server.errors import RefusedError
from server.moveit.poses import composed, inverse, matrix_of, pose_of, read_pose, write_pose

numbers = st.floats(-1.0, 1.0)
directions = st.tuples(numbers, numbers, numbers, numbers).filter(lambda q: np.linalg.norm(q) > 0.1)


@st.composite
def poses(draw):
    quaternion = np.array(draw(directions))
    unit = quaternion / np.linalg.norm(quaternion)
    return Pose(draw(st.tuples(numbers, numbers, numbers)), tuple(unit.tolist()))


def same(one, other):
    return matrix_of(one) == pytest.approx(matrix_of(other), abs=1e-9)


@given(poses())
def test_a_pose_survives_its_matrix_and_its_message(pose):
    assert same(pose_of(matrix_of(pose)), pose)
    assert same(read_pose(write_pose(pose), "pose"), pose)


@given(poses(), poses())
def test_a_pose_and_its_inverse_cancel(outer, inner):
    assert same(composed(inverse(outer), composed(outer, inner)), inner)


@given(poses())
def test_the_length_of_a_quaternion_does_not_matter(pose):
    message = write_pose(pose)
    message["orientation"] = {axis: 3.0 * value for axis, value in message["orientation"].items()}
    assert same(read_pose(message, "pose"), pose)


def test_a_quaternion_of_zeros_is_no_rotation():
    message = write_pose(Pose((0.1, 0.2, 0.3))) | {"orientation": dict.fromkeys("xyzw", 0.0)}
    assert read_pose(message, "pose") == Pose((0.1, 0.2, 0.3))


@pytest.mark.parametrize(("field", "axis"), [("position", "y"), ("orientation", "w")])
def test_a_number_that_is_not_finite_is_refused_by_its_path(field, axis):
    message = write_pose(Pose())
    message[field][axis] = float("nan")
    with pytest.raises(RefusedError, match=rf"target\.pose\.{field}\.{axis}"):
        read_pose(message, "target.pose")
