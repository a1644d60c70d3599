import base64
import io
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from protocol.codecs import png
from protocol.errors import FrameError


def drawn(mode, size):
    buffer = io.BytesIO()
    Image.new(mode, size).save(buffer, format="PNG")
    return base64.b64encode(buffer.getvalue()).decode()


@given(st.binary(max_size=2000).filter(lambda frame: not frame.endswith(b"\n")))
def test_text_in_a_picture_is_read_back_but_for_newlines_behind_it(frame):
    assert png.decode(png.encode(frame)).rstrip(b"\n") == frame


@given(st.integers(3, 3000))
def test_a_picture_is_as_square_as_can_be_and_its_pixels_are_the_frame(size):
    frame = b"x" * size
    picture = Image.open(io.BytesIO(base64.b64decode(png.encode(frame))))
    assert picture.mode == "RGB"
    assert abs(picture.width - math.sqrt(size / 3)) <= 1
    assert picture.height >= picture.width
    assert picture.tobytes() == frame.ljust(picture.width * picture.height * 3, b"\n")


@pytest.mark.parametrize("data", ["", "no base64!", "aGVsbG8=", drawn("RGB", (4, 4))[:60]])
def test_data_that_is_no_picture_is_refused(data):
    with pytest.raises(FrameError):
        png.decode(data)


@pytest.mark.parametrize("mode", ["L", "RGBA", "P"])
def test_other_modes_are_refused_by_name(mode):
    with pytest.raises(FrameError, match=f"mode {mode}"):
        png.decode(drawn(mode, (2, 2)))


@pytest.mark.parametrize("size", [(3000, 3000), (14_000, 14_000)])
def test_a_small_picture_of_a_huge_frame_is_refused_before_it_is_unpacked(size):
    with pytest.raises(FrameError, match=r"limit is 10000000|Decompression"):
        png.decode(drawn("1" if size[0] > 10_000 else "RGB", size))


def test_a_picture_of_text_is_smaller_than_the_text():
    frame = b'{"position":[0.123456789,0.987654321,-0.55555555]}' * 1000
    assert len(png.encode(frame)) < len(frame) / 10
