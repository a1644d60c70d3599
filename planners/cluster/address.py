"""Where a Dask scheduler is, as settings write it: ``dask://host:8786`` or ``dask+tls://host:8786``."""

from __future__ import annotations

from urllib.parse import urlsplit

# Scheme of the setting -> Dask's.
SCHEMES = {"dask": "tcp", "dask+tls": "tls"}


def scheduler_address(text: str) -> str:
    """The address as Dask takes it, as in ``tcp://host:8786``.

    Raises:
        ValueError: what is no such address.
    """
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{text!r} is no address: {error}") from error
    if parts.scheme not in SCHEMES:
        raise ValueError(f"{text!r} must begin with {' or '.join(f'{scheme}://' for scheme in SCHEMES)}")
    if not host or not port or parts.netloc.count("@") or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError(f"{text!r} must be {parts.scheme}://HOST:PORT, with a port of 1 to 65535 and nothing else")
    return f"{SCHEMES[parts.scheme]}://{parts.netloc}"
