"""PNG pictures that carry a JSON frame: its bytes are the pixels, red, green and blue, row by row.

The picture is as square as can be, and newlines fill its last row (rosbridge_library, internal/pngcompression.py).
"""

from __future__ import annotations

import binascii
import io
import math
import warnings

from PIL import Image

from protocol.errors import FrameError

# Pictures shrink a thousandfold, so the size of what came is no bound; this is rosbridge's max_message_size.
MAX_DECODED_BYTES = 10_000_000

_BYTES_A_PIXEL = 3

# On a megabyte of JSON numbers half the time of zlib's usual 6, as quick as 1, and smaller than both.
_COMPRESSION_LEVEL = 3


def encode(frame: bytes) -> str:
    """Draw a frame and return the PNG as base64 text.

    Args:
        frame: JSON text in ASCII.
    """
    pixels = math.ceil(len(frame) / _BYTES_A_PIXEL)
    width = max(1, math.isqrt(pixels))
    height = max(1, math.ceil(pixels / width))
    picture = Image.frombytes("RGB", (width, height), frame.ljust(width * height * _BYTES_A_PIXEL, b"\n"))
    drawn = io.BytesIO()
    picture.save(drawn, format="PNG", compress_level=_COMPRESSION_LEVEL)
    return binascii.b2a_base64(drawn.getvalue(), newline=False).decode()


def decode(data: str) -> bytes:
    """Return the frame that a PNG carries, perhaps with newlines behind it.

    Args:
        data: the PNG as base64 text.

    Raises:
        FrameError: no base64, no PNG, or more than `MAX_DECODED_BYTES` inside.
    """
    try:
        drawn = binascii.a2b_base64(data, strict_mode=True)
    except ValueError as error:
        raise FrameError("not base64") from error
    try:
        return _pixels(drawn)
    except FrameError:
        raise
    # The library raises what its parsers raise: OSError, SyntaxError, ValueError, struct.error, zlib.error and more.
    except Exception as error:
        raise FrameError(f"not a PNG, {type(error).__name__}") from error


def _pixels(drawn: bytes) -> bytes:
    with warnings.catch_warnings():
        # Its warning of large pictures comes at a limit far above the one below.
        warnings.simplefilter("ignore")
        picture = Image.open(io.BytesIO(drawn), formats=("PNG",))
    size_bytes = picture.width * picture.height * _BYTES_A_PIXEL
    if size_bytes > MAX_DECODED_BYTES:
        raise FrameError(f"a picture of {size_bytes} bytes, the limit is {MAX_DECODED_BYTES}")
    if picture.mode != "RGB":
        raise FrameError(f"a picture of mode {picture.mode}, wanted RGB")
    return picture.tobytes()
