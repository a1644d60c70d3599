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


@given(st.binary(max_size=2000).filter(lambda frame: not frame.endswith(b"\n")), st.integers(3, 3000))
def test_text_in_a_picture_as_square_as_can_be_is_read_back_but_for_newlines_behind_it(frame, size):
    assert png.decode(png.encode(frame)).rstrip(b"\n") == frame
    frame = b"x" * size
    picture = Image.open(io.BytesIO(base64.b64decode(png.encode(frame))))
    assert picture.mode == "RGB"
    assert abs(picture.width - math.sqrt(size / 3)) <= 1
    assert picture.height >= picture.width
    assert picture.tobytes() == frame.ljust(picture.width * picture.height * 3, b"\n")


def test_data_that_is_no_picture_or_one_of_another_mode_or_of_a_huge_frame_is_refused():
    for data, words in (
        ("", "not"),
        ("no base64!", "not"),
        ("aGVsbG8=", "not"),
        (drawn("RGB", (4, 4))[:60], "not"),
        *((drawn(mode, (2, 2)), f"mode {mode}") for mode in ("L", "RGBA", "P")),
        # Before it is unpacked.
        (drawn("RGB", (3000, 3000)), r"limit is 10000000"),
        (drawn("1", (14_000, 14_000)), "Decompression"),
    ):
        with pytest.raises(FrameError, match=words):
            png.decode(data)


def test_a_picture_of_text_is_smaller_than_the_text():
    frame = b'{"position":[0.123456789,0.987654321,-0.55555555]}' * 1000
    assert len(png.encode(frame)) < len(frame) / 10
