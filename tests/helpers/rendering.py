"""Rendered images in tests, on machines that can render."""

import ctypes.util

import numpy as np
import pytest
from numpy.typing import NDArray

needs_egl = pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="no EGL: images are not rendered here")


def red_pixels(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Columns and rows of the red pixels of an image, shape (n, 2)."""
    red, green, blue = np.moveaxis(image.astype(int), 2, 0)
    rows, columns = np.nonzero((red - green > 60) & (red - blue > 60))
    return np.column_stack((columns, rows))
