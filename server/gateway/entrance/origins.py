"""The pages that may connect.

A browser lets every page open a WebSocket to every address that its machine reaches, and tells the server only in
``Origin`` whose page it is.
"""

from __future__ import annotations

from collections.abc import Iterable

from server.gateway.entrance.addresses import Authority, matches, read_authority

# Of the schemes that pages have.
_PORTS = {"http": 80, "https": 443}


class Origins:
    """Whose pages may connect: those of this machine, the server's own, and those that are named.

    Args:
        allowed: origins, as ``access.allowed_origins`` has them: ``*`` for any text; ``null`` is that of a page from
            a file or a sandbox.
    """

    def __init__(self, allowed: Iterable[str] = ()) -> None:
        # As people copy it out of a browser, an origin ends in a slash.
        self._allowed = tuple(text for each in allowed for text in (each.lower(), each.lower().removesuffix("/")))

    def has(self, origin: str, host: Authority, *, encrypted: bool) -> bool:
        """Whether pages of an origin may connect.

        Args:
            origin: as the header has it.
            host: whom the request is for.
            encrypted: whether it came over TLS.
        """
        origin = origin.lower()
        if any(matches(origin, pattern) for pattern in self._allowed):
            return True
        scheme, separator, rest = origin.partition("://")
        theirs = read_authority(rest) if separator and scheme in _PORTS else None
        if theirs is None:
            return False
        return theirs.is_loopback or self._is_own(scheme, theirs, host, "https" if encrypted else "http")

    def _is_own(self, scheme: str, theirs: Authority, host: Authority, own_scheme: str) -> bool:
        port = _PORTS[own_scheme]
        same_port = (theirs.port or port) == (host.port or port)
        return scheme == own_scheme and theirs.host == host.host and same_port
