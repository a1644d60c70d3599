from planners.errors import PlannerError, ShapeError


def test_shape_error_names_the_subject_and_the_reason():
    error = ShapeError("base.stl", "is empty")
    assert isinstance(error, PlannerError)
    assert (error.subject, error.reason) == ("base.stl", "is empty")
    assert "base.stl" in str(error)
    assert "is empty" in str(error)
