"""Names and metadata on the wire, as rmw_zenoh has them (ros2/rmw_zenoh, docs/design.md).

A topic or service has the key ``<domain>/<name>/<type as DDS spells it>/<hash of the type>``; a key that differs in one
part is another topic. Every node and endpoint is announced by a liveliness token ``@ros2_lv/<domain>/<session>/<node>/
<entity>/<kind>/<enclave>/<namespace>/<node name>``, for endpoints with ``/<name>/<type>/<hash>/<quality of service>``
behind it; slashes within a part are written ``%``.
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

# Prefix of all tokens, of all domains; two stars alone never match this.
ADMIN_SPACE = "@ros2_lv"

NODE_NAME = "armbridge"

# Longer tokens are no robot's; they would be kept for as long as the session that invents them lasts.
MAX_TOKEN_CHARACTERS = 2048

GID_BYTES = 16

# Differences from rmw_zenoh's defaults: reliable, volatile, the last 42 samples.
_QOS_VOLATILE, _QOS_LATCHED = "::,10:,:,:,,", ":1:,1:,:,:,,"
_TRANSIENT_LOCAL = "1"

_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_DDS_TYPE = re.compile(r"(?P<package>\w+)::(?P<kind>msg|srv|action)::dds_::(?P<name>\w+)_")
_ENDPOINT_PARTS = 13

# zenoh's own serialization: two int64 in little-endian order, and the sender's id behind its length.
_ATTACHMENT = struct.Struct(f"<qqB{GID_BYTES}s")


class EntityKind(Enum):
    """Kind of an entity, as tokens spell it."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Endpoint:
    """Topic or service on the network."""

    name: str
    type_name: str
    type_hash: str

    def key(self, domain_id: int) -> str:
        return f"{domain_id}/{self.name.strip('/')}/{dds_type(self.type_name)}/{self.type_hash}"


@dataclass(frozen=True)
class Entity:
    """Publisher, subscription, service or client that a token announces."""

    kind: EntityKind
    session: str
    endpoint: Endpoint
    latched: bool

    @classmethod
    def parse(cls, token: str) -> Entity | None:
        """Parse a liveliness token; None for a node's, and for text that is no token of rmw_zenoh."""
        parts = token.split("/")
        if len(parts) < _ENDPOINT_PARTS or parts[0] != ADMIN_SPACE or len(token) > MAX_TOKEN_CHARACTERS:
            return None
        _, _, session, _, _, kind, _, _, _, mangled, dds, type_hash, qos = parts[:_ENDPOINT_PARTS]
        name, found = mangled.replace("%", "/"), _DDS_TYPE.fullmatch(dds)
        if found is None or not is_name(name) or kind not in {each.value for each in EntityKind}:
            return None
        endpoint = Endpoint(name, f"{found['package']}/{found['kind']}/{found['name']}", type_hash)
        latched = qos.split(":")[1:2] == [_TRANSIENT_LOCAL]
        return cls(EntityKind(kind), session, endpoint, latched)


class LivelinessTokens:
    """Key expressions of one server's liveliness tokens."""

    def __init__(self, domain_id: int, session: str, namespace: str) -> None:
        self.domain_id = domain_id
        self.session = session
        self.namespace = namespace
        self._prefix = f"{ADMIN_SPACE}/{domain_id}/{session}/0"
        self._node = f"%/{(namespace or '/').replace('/', '%')}/{NODE_NAME}"
        self._entities = 0

    def node(self) -> str:
        return f"{self._prefix}/0/{EntityKind.NODE.value}/{self._node}"

    def entity(self, kind: EntityKind, endpoint: Endpoint, *, latched: bool = False) -> str:
        self._entities += 1
        qos = _QOS_LATCHED if latched else _QOS_VOLATILE
        spelled = f"{endpoint.name.replace('/', '%')}/{dds_type(endpoint.type_name)}/{endpoint.type_hash}/{qos}"
        return f"{self._prefix}/{self._entities}/{kind.value}/{self._node}/{spelled}"


class Attachment(NamedTuple):
    """Attachment of a message, request or response; rmw_zenoh drops those that have none."""

    sequence_number: int
    source_timestamp_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return _ATTACHMENT.pack(self.sequence_number, self.source_timestamp_ns, GID_BYTES, self.gid)

    @classmethod
    def decode(cls, octets: bytes) -> Attachment | None:
        """Decode octets; None if they are no attachment of rmw_zenoh."""
        if len(octets) != _ATTACHMENT.size:
            return None
        sequence_number, source_timestamp_ns, gid_bytes, gid = _ATTACHMENT.unpack(octets)
        return cls(sequence_number, source_timestamp_ns, gid) if gid_bytes == GID_BYTES else None


def gid_of(token: str) -> bytes:
    """Return the id of the entity with a token: unique to it, and always the same."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()


def is_name(name: str) -> bool:
    """Return True for a fully qualified ROS 2 name; in a key, other names may mean something else, or nothing."""
    return _NAME.fullmatch(name) is not None


def dds_type(type_name: str) -> str:
    """Spell a canonical type name as DDS does: ``std_msgs/msg/String`` as ``std_msgs::msg::dds_::String_``."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"
