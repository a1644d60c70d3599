"""Names of topics: clients write them with and without the leading slash."""

from __future__ import annotations


def qualify(name: str) -> str:
    """Return the fully qualified name: the same topic has one key, however it is spelled.

    rosbridge clients have no namespace of their own, so a relative name lives in the root namespace.
    """
    return name if name.startswith("/") else f"/{name}"
