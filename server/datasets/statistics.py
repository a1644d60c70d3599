"""Statistics of a dataset's features, by which policies normalize: extremes, mean, deviation and quantiles."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

# Names as in lerobot's files.
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

# Values of a feature by the statistic's name, as lists that JSON and Parquet hold.
Statistics: TypeAlias = dict[str, list[Any]]

LEVELS = 256


def statistics_of(values: NDArray[Any]) -> Statistics:
    """Return the statistics of a feature of shape (frames,) or (frames, n), over its frames."""
    columns = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    quantiles = np.quantile(columns, list(QUANTILES.values()), axis=0)
    return {
        "min": columns.min(axis=0).tolist(),
        "max": columns.max(axis=0).tolist(),
        "mean": columns.mean(axis=0).tolist(),
        "std": columns.std(axis=0).tolist(),
        "count": [len(columns)],
        **dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    }


class ImageStatistics:
    """Statistics of a camera's frames, channel by channel, from the histogram of their pixels."""

    def __init__(self) -> None:
        self.frames = 0
        self._histogram = np.zeros((3, LEVELS), dtype=np.int64)

    def add(self, image: NDArray[np.uint8], times: int = 1) -> None:
        """Add the pixels of a frame, shape (height, width, 3)."""
        self.frames += times
        for channel in range(3):
            self._histogram[channel] += times * np.bincount(image[:, :, channel].ravel(), minlength=LEVELS)

    def merge(self, other: ImageStatistics) -> None:
        """Add the frames of others."""
        self.frames += other.frames
        self._histogram += other._histogram

    def result(self) -> Statistics:
        """Return the statistics of values 0 to 1, each of shape (3, 1, 1), as lerobot has statistics of images."""
        levels = np.arange(LEVELS) / (LEVELS - 1)
        pixels = self._histogram.sum(axis=1, keepdims=True)
        shares = self._histogram / pixels
        mean = shares @ levels
        std = np.sqrt(np.maximum(shares @ levels**2 - mean**2, 0.0))
        # The least level that at least this share of the pixels does not exceed.
        reached = np.cumsum(self._histogram, axis=1) / pixels
        seen = self._histogram > 0
        result = {
            "min": levels[np.argmax(seen, axis=1)],
            "max": levels[LEVELS - 1 - np.argmax(seen[:, ::-1], axis=1)],
            "mean": mean,
            "std": std,
            **{name: levels[np.argmax(reached >= share, axis=1)] for name, share in QUANTILES.items()},
        }
        return {**{name: values.reshape(3, 1, 1).tolist() for name, values in result.items()}, "count": [self.frames]}
