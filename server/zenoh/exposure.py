"""Whether somebody unknown could send commands over zenoh, which asks nobody who they are unless it is told to."""

from __future__ import annotations

import re
from collections.abc import Iterable

from server.access.rate_limits import is_loopback

# With certificates on both sides, these let in only those who have one.
_WITH_CERTIFICATES = ("tls", "quic")

_ENDPOINT = re.compile(r"(?P<protocol>[a-z0-9_-]+)/(?P<host>\[[^]]+\]|[^:/?#]*)")


def is_endpoint(text: str) -> bool:
    """Whether a text has the form of an endpoint, protocol and address."""
    return _ENDPOINT.match(text) is not None


def open_endpoint(endpoints: Iterable[str], *, mutual_tls: bool) -> str | None:
    """The first endpoint that lets other machines in without asking who they are; None when none does.

    Args:
        endpoints: where zenoh listens.
        mutual_tls: whether those who connect by TLS must show a certificate.
    """
    return next((each for each in endpoints if not _is_guarded(each, mutual_tls)), None)


def _is_guarded(endpoint: str, mutual_tls: bool) -> bool:
    found = _ENDPOINT.match(endpoint)
    if found is None:
        return False
    protocol, host = found["protocol"], found["host"].strip("[]")
    if protocol.startswith("unix") or host == "localhost":
        return True
    if protocol in _WITH_CERTIFICATES and mutual_tls:
        return True
    return is_loopback(host)
