import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planners.scene import Pose
from server.errors import RefusedError
from server.moveit.messages import composed, inverse, matrix_of, pose_of, read_pose, write_pose

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


@pytest.mark.parametrize(("field", "axis"), [("position", "y"), ("orientation", "w")])
def test_a_number_that_is_not_finite_is_refused_by_its_path(field, axis):
    message = write_pose(Pose())
    message[field][axis] = float("nan")
    with pytest.raises(RefusedError, match=rf"target\.pose\.{field}\.{axis}"):
        read_pose(message, "target.pose")
