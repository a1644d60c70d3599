"""What goes over the socket: frames, and parcels of them."""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

from protocol.fragments import split
from protocol.limits import MAX_PIECES

# What the interpreter spends on a waiting frame beside its bytes (170 were measured, the rest is the allocator's),
# so that a flood of tiny frames is bounded too.
FRAME_OVERHEAD_BYTES = 256

# First byte of a WebSocket frame: the last of its message (0x80), text or binary (RFC 6455, 5.2).
_TEXT, _BINARY = 0x81, 0x82

# In place of a length from 0 to 125: the length follows in two bytes, or in eight (RFC 6455, 5.2).
_TWO_BYTE_LENGTH, _EIGHT_BYTE_LENGTH = 126, 127


class Frame(NamedTuple):
    """What goes over the socket in one piece.

    Attributes:
        data: the frame's bytes; of a text frame they are ASCII.
        text: whether it goes as a text frame, not a binary one.
    """

    data: bytes
    text: bool

    def on_wire(self) -> bytes:
        """Return the WebSocket frame around the data (RFC 6455, 5.2), as a server sends it: whole, and not masked."""
        opening, length = _TEXT if self.text else _BINARY, len(self.data)
        if length < _TWO_BYTE_LENGTH:
            return struct.pack("!BB", opening, length) + self.data
        if length < 1 << 16:
            return struct.pack("!BBH", opening, _TWO_BYTE_LENGTH, length) + self.data
        return struct.pack("!BBQ", opening, _EIGHT_BYTE_LENGTH, length) + self.data


class Parcel:
    """What is sent or dropped as a whole.

    Args:
        frames: one frame, or the fragments of one, in order.

    Attributes:
        frames: as given.
        size_bytes: what it costs while it waits.
    """

    __slots__ = ("_on_wire", "frames", "size_bytes")

    def __init__(self, *frames: Frame) -> None:
        self.frames = frames
        self.size_bytes = 0
        # One frame, as a parcel mostly has, is not worth the set-up of a sum.
        for frame in frames:
            self.size_bytes += len(frame.data) + FRAME_OVERHEAD_BYTES
        self._on_wire: bytes | None = None

    @property
    def on_wire(self) -> bytes:
        """The WebSocket frames, one behind the other; made once for all clients that they are sent to."""
        if self._on_wire is None:
            first, *others = self.frames
            self._on_wire = first.on_wire() + b"".join([frame.on_wire() for frame in others])
        return self._on_wire


def pack(frame: Frame, fragment_size: int | None, fragment_id: str) -> Parcel:
    """Cut a text frame that is too long for its client into fragments.

    Args:
        frame: the frame; binary ones stay whole.
        fragment_size: greatest length of a piece [characters], None for any; a message that would become more than
            `MAX_PIECES` is cut into longer ones.
        fragment_id: a mark that no other frame to the same client has.
    """
    length = len(frame.data)
    if fragment_size is None or length <= fragment_size or not frame.text:
        return Parcel(frame)
    size = max(fragment_size, math.ceil(length / MAX_PIECES))
    return Parcel(*(Frame(piece, text=True) for piece in split(frame.data.decode("ascii"), size, fragment_id)))
