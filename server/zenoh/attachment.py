"""What rmw_zenoh attaches to every message, request and response: who sent it, as the how-manieth, and when.

Without it rmw_zenoh drops a message. Written as zenoh's own serialization does: two int64 in little-endian order, and
the sender's id behind its length.
"""

from __future__ import annotations

import hashlib
import struct
from typing import NamedTuple

GID_BYTES = 16
_FORM = struct.Struct(f"<qqB{GID_BYTES}s")


class Attachment(NamedTuple):
    """The how-manieth of its sender, when it was sent [ns since the epoch], and the sender's id."""

    sequence_number: int
    source_timestamp_ns: int
    gid: bytes

    def written(self) -> bytes:
        """The octets."""
        return _FORM.pack(self.sequence_number, self.source_timestamp_ns, GID_BYTES, self.gid)


def read(octets: bytes) -> Attachment | None:
    """Read an attachment; None when it is none."""
    if len(octets) != _FORM.size:
        return None
    sequence_number, source_timestamp_ns, gid_bytes, gid = _FORM.unpack(octets)
    return Attachment(sequence_number, source_timestamp_ns, gid) if gid_bytes == GID_BYTES else None


def gid_of(token: str) -> bytes:
    """An id for whoever has this token: nobody else's, and the same whenever it is asked for."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()
