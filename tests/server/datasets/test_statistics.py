from __future__ import annotations

import numpy as np
import pytest

from server.datasets.lerobot import QUANTILES, ImageStatistics


def test_statistics_of_images_are_those_of_their_pixels_in_all_frames() -> None:
    images = np.random.default_rng(1).integers(0, 256, size=(2, 20, 30, 3), dtype=np.uint8)
    statistics = ImageStatistics()
    statistics.add(images[0], 3)
    other = ImageStatistics()
    other.add(images[1])
    statistics.merge(other)
    told = statistics.result()
    pixels = np.concatenate([images[:1]] * 3 + [images[1:]]).reshape(-1, 3) / 255.0
    assert told["count"] == [4]
    assert np.shape(told["mean"]) == (3, 1, 1)
    for name, expected in {
        "min": pixels.min(0),
        "max": pixels.max(0),
        "mean": pixels.mean(0),
        "std": pixels.std(0),
    }.items():
        assert np.ravel(told[name]) == pytest.approx(expected)
    for name, share in QUANTILES.items():
        assert np.ravel(told[name]) == pytest.approx(np.quantile(pixels, share, axis=0), abs=1 / 255)
