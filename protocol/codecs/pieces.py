"""Values encoded in pieces, so that no encoder holds the interpreter's lock for long.

An encoder holds the lock until it has written its value to the end: a second for a million values. A value that costs
more than a piece is taken apart: short members go together, and long ones are taken apart again. In between, other
threads have their turn.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Any

# JSON of a value of a message: a number with its comma, and with the name of its field where it has one.
VALUE_BYTES = 12

# Cost of a piece: 700 numbers, 0.7 ms for the slowest encoder.
PIECE_BYTES = 8_192

_TEXTS = frozenset((str, bytes))
_COSTLY = _TEXTS | {dict, list}


def encoding_cost_bytes(value: object, limit_bytes: int) -> int:
    """Estimate the JSON of a message, reading no further than a limit of it [bytes]."""
    # Level by level, because work on all members of a level at once needs no interpreter: a mesh of
    # 80,000 triangles takes 30 ms instead of 200.
    cost_bytes, level = 0, [value]
    while True:
        kinds = set(map(type, level))
        inner: list[Any] = []
        for kind in kinds & _COSTLY:
            members: list[Any] = level if len(kinds) == 1 else [each for each in level if type(each) is kind]
            length = sum(map(len, members))
            cost_bytes += length if kind in _TEXTS else length * VALUE_BYTES
            if cost_bytes >= limit_bytes:
                return limit_bytes
            if kind is list:
                inner.extend(chain.from_iterable(members))
            elif kind is dict:
                inner.extend(chain.from_iterable(map(dict.values, members)))
        if not inner:
            return cost_bytes
        level = inner


@dataclass(frozen=True)
class Notation:
    """Bytes of an encoding around the members of maps and lists."""

    encode: Callable[[Any], bytes]
    map_head: Callable[[int], bytes]
    list_head: Callable[[int], bytes]
    map_tail: bytes = b""
    list_tail: bytes = b""
    separator: bytes = b""
    colon: bytes = b""


def json_notation(encode: Callable[[Any], bytes]) -> Notation:
    return Notation(encode, lambda _length: b"{", lambda _length: b"[", b"}", b"]", b",", b":")


def encoded_pieces(value: Any, notation: Notation, piece_bytes: int = PIECE_BYTES) -> Iterator[bytes]:
    """Encode a value piece by piece, each of a cost of ``piece_bytes``; a single long text is a piece by itself."""
    if type(value) not in (dict, list) or encoding_cost_bytes(value, piece_bytes) < piece_bytes:
        yield notation.encode(value)
        return
    head, tail = notation.map_head, notation.map_tail
    if type(value) is list:
        head, tail = notation.list_head, notation.list_tail
    yield head(len(value))
    separator = b""
    for run in _runs(value, piece_bytes):
        if separator:
            yield separator
        separator = notation.separator
        if len(run) > 1:
            encoded = notation.encode(run)
            yield encoded[len(head(len(run))) : len(encoded) - len(tail)]
        elif type(run) is dict:
            ((key, member),) = run.items()
            yield notation.encode(key) + notation.colon
            yield from encoded_pieces(member, notation, piece_bytes)
        else:
            yield from encoded_pieces(run[0], notation, piece_bytes)
    yield tail


def _runs(value: dict[Any, Any] | list[Any], piece_bytes: int) -> Iterator[dict[Any, Any] | list[Any]]:
    """Cut a map or a list into maps or lists of members that make a piece together, or of one long member."""
    if isinstance(value, list):
        for start, end in _cuts(value, piece_bytes):
            yield value[start:end]
    else:
        items = list(value.items())
        for start, end in _cuts([member for _, member in items], piece_bytes):
            yield dict(items[start:end])


def _cuts(members: list[Any], piece_bytes: int) -> Iterator[tuple[int, int]]:
    """Return the bounds of runs of members that cost less than a piece together, and of single ones."""
    start, count = 0, 1
    while start < len(members):
        cost_bytes = encoding_cost_bytes(members[start : start + count], piece_bytes)
        if cost_bytes >= piece_bytes and count > 1:
            count = max(1, count // 2)
            continue
        yield start, min(start + count, len(members))
        start += count
        # Members that follow one another are mostly alike.
        if cost_bytes < piece_bytes // 2:
            count *= 2
