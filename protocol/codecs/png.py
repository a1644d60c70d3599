"""PNG pictures that carry a JSON frame: its bytes are the pixels, red, green and blue, row by row.

The picture is as square as can be, and newlines fill its last row (rosbridge_library, internal/pngcompression.py).
It is written here, without the filters that PNG has for the rows of photographs (PNG 1.2, section 6): text shrinks
better without, and trying them all on every row costs more time than the compression.
"""

import binascii
import io
import math
import struct
import warnings
import zlib

from PIL import Image, ImageFile

from protocol.errors import FrameError

# Pictures shrink a thousandfold, so the size of what came is no bound; this is rosbridge's max_message_size.
MAX_DECODED_BYTES = 10_000_000

# Piece of a picture that is decoded at a time: at most two megabytes of pixels, which take 8 ms.
FED_BYTES = 2048

_BYTES_A_PIXEL = 3

_SIGNATURE = b"\x89PNG\r\n\x1a\n"

# Eight bits for each of red, green and blue; deflate, the usual set of filters, no interlace (PNG 1.2, section 4.1.1).
_HEADER = struct.Struct(">IIBBBBB")
_RGB = (8, 2, 0, 0, 0)

# What stands before a row that is not filtered.
_NO_FILTER = b"\x00"

# The quickest of zlib: on a megabyte of JSON numbers half the time of level 3, for 5 % more bytes.
_COMPRESSION_LEVEL = 1


def encode(frame: bytes) -> str:
    """Draw a frame of ASCII text and return the PNG as base64 text."""
    pixels = math.ceil(len(frame) / _BYTES_A_PIXEL)
    width = max(1, math.isqrt(pixels))
    height = max(1, math.ceil(pixels / width))
    row_bytes = width * _BYTES_A_PIXEL
    filled = frame.ljust(row_bytes * height, b"\n")
    rows = b"".join([_NO_FILTER + filled[start : start + row_bytes] for start in range(0, len(filled), row_bytes)])
    chunks = (
        _SIGNATURE,
        _chunk(b"IHDR", _HEADER.pack(width, height, *_RGB)),
        _chunk(b"IDAT", zlib.compress(rows, _COMPRESSION_LEVEL)),
        _chunk(b"IEND", b""),
    )
    return binascii.b2a_base64(b"".join(chunks), newline=False).decode()


def _chunk(name: bytes, data: bytes) -> bytes:
    return b"".join((struct.pack(">I", len(data)), name, data, struct.pack(">I", zlib.crc32(data, zlib.crc32(name)))))


def decode(data: str) -> bytes:
    """Return the frame that a PNG carries, perhaps with newlines behind it.

    Raises FrameError: no base64, no PNG, or more than `MAX_DECODED_BYTES` inside.
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
    # The decoder holds the interpreter's lock until it has read what it was given.
    parser = ImageFile.Parser()
    for start in range(0, len(drawn), FED_BYTES):
        parser.feed(drawn[start : start + FED_BYTES])
    return parser.close().tobytes()
