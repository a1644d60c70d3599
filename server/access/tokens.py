"""Tokens: who a client is that shows one, and who it is without."""

from __future__ import annotations

import hmac
import logging
import stat
import tomllib
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

from pydantic import ValidationError

from server.access.roles import Identity, Role
from server.access.settings import MAX_TOKENS, AccessSettings
from server.errors import ConfigurationError, sentence_of

log = logging.getLogger("armbridge.access")

# Of the one token that has no name of its own.
TOKEN_NAME = "admin"  # noqa: S105 - a name

_ROLES = {"admin_tokens": Role.ADMIN, "operate_tokens": Role.OPERATE, "view_tokens": Role.VIEW}
_IN_FILE = frozenset({"token", *_ROLES})


class Tokens:
    """All tokens.

    Args:
        tokens: whose each is, by its text.
        anonymous: who comes without a token; None when nobody may.

    Attributes:
        any: whether there are tokens.
        anonymous: as given.
    """

    def __init__(self, tokens: dict[str, Identity], anonymous: Identity | None) -> None:
        # By digest: all have one length, so that comparing tells nothing of a token's.
        self._tokens = [(_digest(token), token, identity) for token, identity in tokens.items()]
        self.any = bool(tokens)
        self.anonymous = anonymous

    @classmethod
    def of(cls, settings: AccessSettings) -> Tokens:
        """Read the settings, and the file that they name.

        Raises:
            ConfigurationError: the file cannot be used, a token has two owners, or nobody could connect.
        """
        found: dict[str, Identity] = {}
        sources = [settings] if settings.token_file is None else [settings, _read(settings.token_file)]
        for token, identity in (each for source in sources for each in _identities(source)):
            if found.setdefault(token, identity) != identity:
                raise ConfigurationError(
                    f"access: {found[token].name} and {identity.name} have the same token; each needs its own"
                )
        if len(found) > MAX_TOKENS:
            raise ConfigurationError(f"access: there are {len(found)} tokens, the limit is {MAX_TOKENS}")
        return cls(found, _anonymous(settings, any_tokens=bool(found)))

    def identify(self, presented: str) -> Identity | None:
        """Whose token this is; None when it is nobody's. It takes as long for every token."""
        wanted, owner = _digest(presented), None
        for digest, _, identity in self._tokens:
            if hmac.compare_digest(digest, wanted):
                owner = identity
        return owner

    def secrets(self) -> Iterator[tuple[str, Identity]]:
        """Every token with its owner, for proofs that do not show it."""
        return ((token, identity) for _, token, identity in self._tokens)


def _digest(token: str) -> bytes:
    return sha256(token.encode(errors="surrogatepass")).digest()


def _identities(settings: AccessSettings) -> Iterator[tuple[str, Identity]]:
    if settings.token is not None:
        yield settings.token.get_secret_value(), Identity(TOKEN_NAME, Role.ADMIN)
    for key, role in _ROLES.items():
        for name, token in getattr(settings, key).items():
            yield token.get_secret_value(), Identity(name, role)


def _anonymous(settings: AccessSettings, *, any_tokens: bool) -> Identity | None:
    chosen = settings.without_token
    if chosen == "auto":
        chosen = "none" if any_tokens else "admin"
    if chosen != "none":
        return Identity("", Role[chosen.upper()])
    if not any_tokens:
        raise ConfigurationError(
            "access.without_token: none lets nobody in while there are no tokens; set access.token or one of "
            f"{', '.join(_ROLES)}"
        )
    return None


def _read(file: Path) -> AccessSettings:
    """The tokens in a file; its refusals never have one.

    Raises:
        ConfigurationError: it cannot be used.
    """
    try:
        if file.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH):
            log.warning("access.token_file: %s can be read by other users of this machine; chmod 600 it", file)
        values = tomllib.loads(file.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"access.token_file: {file} cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"access.token_file: {file} is not TOML: {error}") from error
    if stray := sorted(values.keys() - _IN_FILE):
        raise ConfigurationError(f"access.token_file: {file} has {stray[0]}; it may have {', '.join(sorted(_IN_FILE))}")
    try:
        return AccessSettings(**values)
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"access.token_file: {file}: {key}: {sentence_of(first)}") from None
