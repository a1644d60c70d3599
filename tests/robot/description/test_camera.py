from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from robot.description.camera import Camera

AHEAD = (0.5, 0.0, 0.2, 0.0, 0.0, 0.2)


def test_the_image_is_upright_and_shows_its_target_in_the_middle() -> None:
    camera = Camera(view=AHEAD)
    assert camera.axes == pytest.approx(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    below = Camera(view=(0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
    assert below.axes[:, 2] == pytest.approx([0.0, 0.0, 1.0])
    for each in (camera, below):
        assert np.linalg.det(each.axes) == pytest.approx(1.0)


def test_the_optical_frame_has_z_along_the_view_and_y_down() -> None:
    transform = Camera(view=AHEAD).transform_optical_to_frame
    assert transform @ (0.0, 0.0, 0.5, 1.0) == pytest.approx((*AHEAD[3:], 1.0))
    assert transform[:3, 1] == pytest.approx([0.0, 0.0, -1.0])


def test_a_point_at_the_upper_edge_is_half_the_field_of_view_above_the_middle() -> None:
    column, row, depth = Camera(view=AHEAD, field_of_view_deg=90.0).intrinsic_matrix @ (0.0, -1.0, 1.0)
    # The middle of the first pixel is (0, 0), and its upper edge half a pixel above.
    assert (column / depth, row / depth) == pytest.approx((159.5, -0.5))


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"view": (0.1,) * 6}, "must look at another point"),
        ({"view": (1.0, 2.0)}, "view"),
        ({"view": (*AHEAD[:5], float("nan"))}, "view.5"),
        ({"width": 321}, "multiple of 2"),
        ({"width": 1282}, "1280"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"field_of_view_deg": 180.0}, "field_of_view_deg"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_wrong_value_is_named(values: dict[str, Any], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        Camera(**{"view": AHEAD, **values})
