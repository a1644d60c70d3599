"""What goes over the socket: frames, and parcels of them."""

from __future__ import annotations

import math
from typing import NamedTuple

from protocol.fragments import split
from protocol.limits import MAX_PIECES

# What the interpreter spends on a waiting frame beside its bytes (170 were measured, the rest is the allocator's),
# so that a flood of tiny frames is bounded too.
FRAME_OVERHEAD_BYTES = 256


class Frame(NamedTuple):
    """What goes over the socket in one piece.

    Attributes:
        data: the frame's bytes; of a text frame they are ASCII.
        text: whether it goes as a text frame, not a binary one.
    """

    data: bytes
    text: bool


class Parcel:
    """What is sent or dropped as a whole.

    Args:
        frames: one frame, or the fragments of one, in order.

    Attributes:
        frames: as given.
        size_bytes: what it costs while it waits.
    """

    __slots__ = ("frames", "size_bytes")

    def __init__(self, *frames: Frame) -> None:
        self.frames = frames
        self.size_bytes = sum([len(frame.data) + FRAME_OVERHEAD_BYTES for frame in frames])


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
