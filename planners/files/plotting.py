"""Motions as a picture: positions and velocities over time, one row a problem."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from planners.errors import PlottingError
from robot.trajectory import Trajectory

# As many rows as can still be looked at in one picture.
MAX_MOTIONS = 20

# Points a curve is drawn with.
POINTS = 400

# Inches of a row, wide and high.
ROW_SIZE_IN = (12.0, 2.6)


def check_available() -> None:
    """Say so early when there is nothing to draw with.

    Raises:
        PlottingError: matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise PlottingError("plots need matplotlib; install it with: pip install matplotlib")


def plot(path: Path, motions: Sequence[tuple[str, Trajectory]]) -> None:
    """Draw motions into a file, the first :data:`MAX_MOTIONS` of them.

    Args:
        path: the picture; its ending says of what kind.
        motions: name and motion.

    Raises:
        PlottingError: there is no motion to draw, or no picture of this ending can be drawn.
    """
    # Loaded when something is drawn: it takes a quarter of a second.
    from matplotlib.figure import Figure

    drawn = motions[:MAX_MOTIONS]
    if not drawn:
        raise PlottingError("there is no motion to plot")
    width_in, height_in = ROW_SIZE_IN
    figure = Figure(figsize=(width_in, height_in * len(drawn)), layout="constrained")
    rows = figure.subplots(len(drawn), 2, squeeze=False)
    for (positions, velocities), (name, motion) in zip(rows, drawn, strict=True):
        times_s = np.linspace(0.0, motion.duration_s, POINTS)
        samples = [motion.sample(time_s) for time_s in times_s]
        positions.plot(times_s, [sample[0] for sample in samples], label=motion.joint_names)
        velocities.plot(times_s, [sample[1] for sample in samples])
        positions.set(title=name, xlabel="time [s]", ylabel="position [rad]")
        velocities.set(title=name, xlabel="time [s]", ylabel="velocity [rad/s]")
    rows[0][0].legend(fontsize="small")
    try:
        figure.savefig(path)
    except ValueError as error:
        raise PlottingError(f"{path} cannot be drawn: {error}") from error
