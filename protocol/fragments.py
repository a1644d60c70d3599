"""Fragments: a long frame in pieces, each an operation of its own (rosbridge protocol, section 3.1.1)."""

from __future__ import annotations

from dataclasses import dataclass, field

from protocol.codecs import json
from protocol.errors import OperationError
from protocol.limits import Limits
from protocol.operations import Fragment


def split(frame: str, size: int, fragment_id: str) -> list[bytes]:
    """Cut a frame into fragments.

    Args:
        frame: JSON text.
        size: greatest length of a piece [characters], at least 1; the envelope comes on top.
        fragment_id: a mark that no other frame to the same client has.

    Returns:
        The fragments' frames, in order.
    """
    pieces = [frame[start : start + size] for start in range(0, len(frame), size)]
    envelope = {"op": "fragment", "id": fragment_id}
    return [
        json.encode({**envelope, "data": piece, "num": number, "total": len(pieces)})
        for number, piece in enumerate(pieces)
    ]


@dataclass(slots=True)
class _Message:
    """A message of which fragments are missing.

    Attributes:
        total: number of its fragments.
        started_s: when its first fragment came [s].
        size_bytes: of all pieces that are there.
        pieces: text by number.
    """

    total: int
    started_s: float
    size_bytes: int = 0
    pieces: dict[int, str] = field(default_factory=dict)


class Reassembly:
    """Puts the fragments of one client together, in whatever order they come.

    Args:
        limits: how much may wait for missing fragments.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        # Oldest first.
        self._messages: dict[str | int, _Message] = {}
        self._fragments = 0
        self._size_bytes = 0

    def add(self, fragment: Fragment, now: float) -> str | None:
        """Take one fragment; one that is there already changes nothing.

        Args:
            fragment: the operation.
            now: present time [s], monotonic.

        Returns:
            The frame, when this was its last missing fragment.

        Raises:
            OperationError: the fragment contradicts itself or others of its id, or a limit is reached; what was
                there of its message is given up.
        """
        self._expire(now)
        message = self._messages.get(fragment.id)
        try:
            self._check(fragment, message)
        except OperationError:
            self._remove(fragment.id)
            raise
        if message is None:
            message = self._messages[fragment.id] = _Message(fragment.total, now)
        if fragment.num not in message.pieces:
            self._store(message, fragment)
        if len(message.pieces) < message.total:
            return None
        self._remove(fragment.id)
        return "".join(message.pieces[number] for number in range(message.total))

    def _check(self, fragment: Fragment, message: _Message | None) -> None:
        limits = self._limits
        if fragment.num >= fragment.total:
            raise _refusal("num", f"wanted less than total = {fragment.total}, got {fragment.num}")
        if fragment.total > limits.max_fragments:
            raise _refusal("total", f"{fragment.total}, the limit is {limits.max_fragments}")
        if message is None and len(self._messages) >= limits.max_fragmented_messages:
            raise _refusal("id", f"{len(self._messages)} messages wait for fragments, which is the limit")
        if message is not None and message.total != fragment.total:
            raise _refusal("total", f"{fragment.total}, but other fragments of this id said {message.total}")
        if message is not None and fragment.num in message.pieces:
            return
        if self._fragments >= limits.max_fragments:
            raise _refusal(None, f"{self._fragments} fragments wait for others, which is the limit")
        size_bytes = self._size_bytes + _size_bytes(fragment.data)
        if size_bytes > limits.max_message_bytes:
            raise _refusal("data", f"{size_bytes} bytes of fragments wait, the limit is {limits.max_message_bytes}")

    def _store(self, message: _Message, fragment: Fragment) -> None:
        size_bytes = _size_bytes(fragment.data)
        message.pieces[fragment.num] = fragment.data
        message.size_bytes += size_bytes
        self._size_bytes += size_bytes
        self._fragments += 1

    def _remove(self, fragment_id: str | int) -> None:
        message = self._messages.pop(fragment_id, None)
        if message is not None:
            self._size_bytes -= message.size_bytes
            self._fragments -= len(message.pieces)

    def _expire(self, now: float) -> None:
        late = now - self._limits.fragment_timeout_s
        for fragment_id in [key for key, message in self._messages.items() if message.started_s < late]:
            self._remove(fragment_id)


def _refusal(name: str | None, problem: str) -> OperationError:
    return OperationError("fragment", name, problem)


def _size_bytes(text: str) -> int:
    return len(text) if text.isascii() else len(text.encode(errors="surrogatepass"))
