"""Description of a server for programs: its arms, and the hashes of its message types (docs/protocol.md)."""

from __future__ import annotations

import json
import ssl
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import urlsplit, urlunsplit

from armbridge_client.errors import ArmError, ConnectError, WrongVersion
from armbridge_client.messages import TYPES

PATH = "armbridge/interface.json"
MAX_BYTES = 4_000_000


@dataclass(frozen=True)
class ArmInfo:
    """An arm of a server, or with an empty name the only arm, or all arms together.

    Attributes:
        group: default planning group.
        groups: joints of each planning group.
        gripper: joints of the gripper, empty without one.
        frame: link in whose axes poses are that name no frame.
        tip: link that pose goals move.
    """

    name: str
    robot: str
    group: str
    groups: Mapping[str, Sequence[str]]
    gripper: Sequence[str]
    frame: str
    tip: str


def read_arms(url: str, token: str | None, tls: ssl.SSLContext | None, timeout_s: float) -> dict[str, ArmInfo]:
    """Read the description behind a WebSocket address, and return its arms by name.

    Raises:
        WrongVersion: a message type differs from this client's.
        ConnectError: the description cannot be read.
    """
    parts = urlsplit(url)
    path = f"{parts.path.rstrip('/')}/{PATH}"
    address = urlunsplit(("https" if parts.scheme == "wss" else "http", parts.netloc, path, "", ""))
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    request = urllib.request.Request(address, headers=headers)  # noqa: S310 - the line before names the scheme
    # No proxy of the environment, as for the WebSocket.
    handlers: list[urllib.request.BaseHandler] = [urllib.request.ProxyHandler({})]
    if parts.scheme == "wss":
        handlers.append(urllib.request.HTTPSHandler(context=tls or ssl.create_default_context()))
    opener = urllib.request.build_opener(*handlers)
    try:
        with opener.open(request, timeout=timeout_s) as answer:
            document = json.loads(answer.read(MAX_BYTES))
            types: Mapping[str, str] = document["types"]
            arms = {each["name"]: ArmInfo(**each) for each in document["arms"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        if isinstance(error, urllib.error.HTTPError):
            error.close()
        raise ConnectError(f"{address}: {error}") from error
    differing = [name for name, fingerprint in TYPES.items() if types.get(name) != fingerprint]
    if differing:
        raise WrongVersion(
            f"{url}: {differing[0]} and {len(differing) - 1} more types are not this client's: install the client "
            "of the server's version"
        )
    return arms


def find_arm(arms: Mapping[str, ArmInfo], name: str) -> ArmInfo:
    """Return an arm by its name; empty for the only arm, or all arms together.

    Raises:
        ArmError: the server has no such arm.
    """
    if name not in arms:
        known = ", ".join(filter(None, arms)) or "one, without a name"
        raise ArmError(f"the server has no arm {name!r}; its arms: {known}")
    return arms[name]
