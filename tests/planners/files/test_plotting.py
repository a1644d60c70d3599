from __future__ import annotations

import sys

import numpy as np
import pytest

from planners.errors import PlottingError
from planners.files import plotting
from robot.trajectory import Trajectory

MOTION = Trajectory(
    ("a", "b"), np.array([0.0, 1.0]), np.array([[0.0, 0.0], [1.0, 2.0]]), np.zeros((2, 2)), np.zeros((2, 2))
)
PNG = b"\x89PNG"


def test_motions_become_a_picture(tmp_path) -> None:
    plotting.plot(tmp_path / "a.png", [("one", MOTION), ("two", MOTION)])
    assert (tmp_path / "a.png").read_bytes().startswith(PNG)


def test_more_motions_than_fit_are_left_out(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(plotting, "MAX_MOTIONS", 1)
    plotting.plot(tmp_path / "one.png", [("one", MOTION)])
    plotting.plot(tmp_path / "two.png", [("one", MOTION), ("two", MOTION)])
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_nothing_to_draw_is_refused(tmp_path) -> None:
    with pytest.raises(PlottingError, match="no motion"):
        plotting.plot(tmp_path / "a.png", [])


def test_a_picture_of_an_unknown_kind_is_refused(tmp_path) -> None:
    with pytest.raises(PlottingError, match="teapot"):
        plotting.plot(tmp_path / "a.teapot", [("one", MOTION)])


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch) -> None:
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "modules", {name: each for name, each in sys.modules.items() if "matplotlib" not in name})
    with pytest.raises(PlottingError, match="pip install matplotlib"):
        plotting.check_available()
