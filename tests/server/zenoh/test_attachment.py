from __future__ import annotations

import zenoh.ext

from server.zenoh import attachment
from server.zenoh.attachment import Attachment

GID = bytes(range(16))


def test_an_attachment_is_written_as_zenoh_serializes_its_parts() -> None:
    parts = (zenoh.ext.Int64(3), zenoh.ext.Int64(1_700_000_000_000_000_001), GID)
    assert Attachment(3, 1_700_000_000_000_000_001, GID).written() == bytes(zenoh.ext.z_serialize(parts))


def test_an_attachment_is_read_back() -> None:
    written = Attachment(7, 12, GID).written()
    assert attachment.read(written) == Attachment(7, 12, GID)


def test_octets_that_are_no_attachment_are_none() -> None:
    written = Attachment(7, 12, GID).written()
    assert attachment.read(b"") is None
    assert attachment.read(written + b"\0") is None
    assert attachment.read(written[:16] + b"\x0f" + GID) is None


def test_everybody_has_an_id_of_their_own_that_stays() -> None:
    assert attachment.gid_of("one") == attachment.gid_of("one") != attachment.gid_of("another")
    assert len(attachment.gid_of("one")) == attachment.GID_BYTES
