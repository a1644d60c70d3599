"""Clients of raw TCP: sockets that send operations one behind the other, and cut what comes into frames."""

import asyncio
import contextlib
import io
import json
import struct
from typing import Any, Self

import bson
import cbor2

from tests.helpers.gateway import TIMEOUT_S

JSON_DECODER = json.JSONDecoder()


class RawClient:
    """A client that speaks BSON or JSON, as its class of framing has it in rosbridge2cpp."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, speaks_bson: bool) -> None:
        self.reader = reader
        self.writer = writer
        self.speaks_bson = speaks_bson
        self.sent_bytes = 0
        self._data = b""

    @classmethod
    async def connect(cls, port: int, *, speaks_bson: bool = False, **options: Any) -> Self:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=2**24, **options)
        return cls(reader, writer, speaks_bson=speaks_bson)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        self.writer.close()
        with contextlib.suppress(ConnectionError):
            await self.writer.wait_closed()

    @property
    def address(self) -> tuple[str, int]:
        host, port = self.writer.get_extra_info("sockname")[:2]
        return str(host), int(port)

    def write(self, data: bytes) -> None:
        self.sent_bytes += len(data)
        self.writer.write(data)

    def send(self, **operation: Any) -> None:
        self.write(bson.encode(operation) if self.speaks_bson else json.dumps(operation).encode())

    async def next_frame(self, timeout_s: float = TIMEOUT_S) -> str | bytes | None:
        """The next frame, JSON as text; None when the server has ended the connection, or when none comes."""
        try:
            async with asyncio.timeout(timeout_s):
                return await (self._document() if self.speaks_bson else self._object())
        except (TimeoutError, asyncio.IncompleteReadError, ConnectionError):
            return None

    async def receive(self) -> dict[str, Any]:
        """The next operation."""
        frame = await self.next_frame()
        assert frame is not None, "nothing came"
        return bson.decode(frame) if isinstance(frame, bytes) else json.loads(frame)

    async def until_topic(self, topic: str) -> dict[str, Any]:
        """The next message of a topic."""
        while True:
            operation = await self.receive()
            if operation.get("topic") == topic:
                return dict(operation["msg"])

    async def _document(self) -> bytes:
        length = await self.reader.readexactly(4)
        return length + await self.reader.readexactly(struct.unpack("<i", length)[0] - 4)

    async def _object(self) -> str | bytes:
        while True:
            found = _object_in(self._data)
            if found is not None:
                frame, self._data = self._data[:found], self._data[found:]
                return frame.decode() if frame.startswith(b"{") else frame
            more = await self.reader.read(65_536)
            if not more:
                raise asyncio.IncompleteReadError(self._data, None)
            self._data += more


def _object_in(data: bytes) -> int | None:
    """Length of the JSON object, or the item of CBOR, that the data begins with."""
    if not data.startswith(b"{"):
        stream = io.BytesIO(data)
        try:
            cbor2.load(stream)
        except cbor2.CBORDecodeEOF:
            return None
        return stream.tell()
    try:
        # What is cut within a character ends before it.
        return len(data.decode(errors="ignore")[: JSON_DECODER.raw_decode(data.decode(errors="ignore"))[1]].encode())
    except json.JSONDecodeError:
        return None
