"""What rmw_zenoh calls things on a zenoh network (ros2/rmw_zenoh, docs/design.md).

A topic or service is the key ``<domain>/<name>/<type as DDS spells it>/<hash of the type>``: who spells one part
otherwise hears nothing. Whoever takes part says so by a liveliness token ``@ros2_lv/<domain>/<session>/<node>/
<entity>/<kind>/<enclave>/<namespace>/<node name>``, for all but nodes with ``/<name>/<type>/<hash>/<quality of
service>`` behind it; slashes within a part are written ``%``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

# All tokens, of all domains; two stars alone never match this.
ADMIN_SPACE = "@ros2_lv"

NODE_NAME = "armbridge"

# Longer names are nobody's; they would be kept for as long as whoever invents them is there.
MAX_TOKEN_CHARACTERS = 2048

# What differs from rmw_zenoh's defaults: reliable, volatile, the last 42 samples.
_QOS_VOLATILE, _QOS_LATCHED = "::,10:,:,:,,", ":1:,1:,:,:,,"
_TRANSIENT_LOCAL = "1"

_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
_DDS_TYPE = re.compile(r"(?P<package>\w+)::(?P<kind>msg|srv)::dds_::(?P<name>\w+)_")
_TOPIC_PARTS = 13


class Kind(Enum):
    """What takes part in the network."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True)
class Endpoint:
    """A topic or service that somebody takes part in.

    Attributes:
        name: fully qualified name.
        type_name: canonical name of its type.
        type_hash: hash of the type, with its prefix.
    """

    name: str
    type_name: str
    type_hash: str

    def key(self, domain_id: int) -> str:
        """The key of its messages, or of its calls."""
        return f"{domain_id}/{self.name.strip('/')}/{dds_type(self.type_name)}/{self.type_hash}"


@dataclass(frozen=True)
class Entity:
    """Somebody who takes part, as a token tells it.

    Attributes:
        kind: how.
        session: id of the zenoh session.
        endpoint: in what.
        latched: whether a publisher keeps its last messages for who comes later.
    """

    kind: Kind
    session: str
    endpoint: Endpoint
    latched: bool


def is_name(name: str) -> bool:
    """Whether a name is a fully qualified one of ROS 2; others may mean something else in a key, or nothing."""
    return _NAME.fullmatch(name) is not None


def dds_type(type_name: str) -> str:
    """Spell a canonical type name as DDS does: ``std_msgs/msg/String`` as ``std_msgs::msg::dds_::String_``."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


class Tokens:
    """Writes the tokens of one server.

    Args:
        domain_id: ROS_DOMAIN_ID.
        session: id of its zenoh session.
        namespace: of its node; empty for the root.
    """

    def __init__(self, domain_id: int, session: str, namespace: str) -> None:
        self._before = f"{ADMIN_SPACE}/{domain_id}/{session}/0"
        self._behind = f"%/{_mangled(namespace or '/')}/{NODE_NAME}"
        self._entities = 0

    def node(self) -> str:
        """The token of the node, which the others belong to."""
        return f"{self._before}/0/{Kind.NODE.value}/{self._behind}"

    def entity(self, kind: Kind, endpoint: Endpoint, *, latched: bool = False) -> str:
        """A new token for one that takes part."""
        self._entities += 1
        qos = _QOS_LATCHED if latched else _QOS_VOLATILE
        what = f"{_mangled(endpoint.name)}/{dds_type(endpoint.type_name)}/{endpoint.type_hash}/{qos}"
        return f"{self._before}/{self._entities}/{kind.value}/{self._behind}/{what}"


def read(token: str) -> Entity | None:
    """Read a token; None for a node, and for what is none of rmw_zenoh's."""
    parts = token.split("/")
    if len(parts) < _TOPIC_PARTS or parts[0] != ADMIN_SPACE or len(token) > MAX_TOKEN_CHARACTERS:
        return None
    _, _, session, _, _, kind, _, _, _, mangled, dds, type_hash, qos = parts[:_TOPIC_PARTS]
    name, found = mangled.replace("%", "/"), _DDS_TYPE.fullmatch(dds)
    if found is None or not is_name(name) or kind not in {each.value for each in Kind}:
        return None
    endpoint = Endpoint(name, f"{found['package']}/{found['kind']}/{found['name']}", type_hash)
    latched = qos.split(":")[1:2] == [_TRANSIENT_LOCAL]
    return Entity(Kind(kind), session, endpoint, latched)


def _mangled(name: str) -> str:
    return name.replace("/", "%")
