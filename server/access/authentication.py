"""Authentication: tokens and their owners, and the throttle of guesses."""

from __future__ import annotations

import contextlib
import hmac
import logging
import stat
from collections import OrderedDict
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

from pydantic import ValidationError

from server.access.rate_limits import client_key
from server.access.settings import MAX_TOKENS, AccessSettings
from server.config_keys import read_toml
from server.errors import ConfigurationError, sentence_of
from server.graph.permissions import Identity, Role

log = logging.getLogger("armbridge.access")

# Name of the owner of `access.token`, which has no name of its own.
TOKEN_NAME = "admin"  # noqa: S105 - a name

_ROLES = {
    "admin_tokens": Role.ADMIN,
    "operate_tokens": Role.OPERATE,
    "propose_tokens": Role.PROPOSE,
    "view_tokens": Role.VIEW,
}
_IN_FILE = frozenset({"token", *_ROLES})

# Wrong tokens from one address after which none is checked for the time of the window [s].
MAX_WRONG = 10
WINDOW_S = 60.0

# Addresses that are remembered, the latest; each costs a kilobyte.
MAX_ADDRESSES = 10_000


class Tokens:
    """Table of the tokens and their owners; ``anonymous`` are clients without, None when they may do nothing."""

    def __init__(self, tokens: dict[str, Identity], anonymous: Identity | None) -> None:
        # By digest: all have one length, so that a comparison shows nothing about a token's length.
        self._tokens = [(digest_of(token), token, identity) for token, identity in tokens.items()]
        self.any = bool(tokens)
        self.anonymous = anonymous

    @classmethod
    def from_settings(cls, settings: AccessSettings) -> Tokens:
        """Read the settings, and the file that they name, or raise ConfigurationError."""
        found: dict[str, Identity] = {}
        sources = [settings] if settings.token_file is None else [settings, _read(settings.token_file)]
        for token, identity in (each for source in sources for each in identities(source)):
            if found.setdefault(token, identity) != identity:
                raise ConfigurationError(
                    f"access: {found[token].name} and {identity.name} have the same token; each needs its own"
                )
        if len(found) > MAX_TOKENS:
            raise ConfigurationError(f"access: there are {len(found)} tokens, the limit is {MAX_TOKENS}")
        chosen = settings.without_token
        if chosen == "auto":
            chosen = "none" if found else "admin"
        if chosen != "none":
            return cls(found, Identity("", Role[chosen.upper()]))
        if not found:
            raise ConfigurationError(
                "access.without_token: none lets nobody in while there are no tokens; set access.token or one of "
                f"{', '.join(_ROLES)}"
            )
        return cls(found, None)

    def identify(self, presented: str) -> Identity | None:
        """Return the owner of a token, None for a wrong one; takes equally long for every text."""
        wanted, owner = digest_of(presented), None
        for digest, _, identity in self._tokens:
            if hmac.compare_digest(digest, wanted):
                owner = identity
        return owner

    def secrets(self) -> Iterator[tuple[str, Identity]]:
        """Return every token with its owner, for a report, which shows neither."""
        return ((token, identity) for _, token, identity in self._tokens)


class AuthThrottle:
    """Throttle of clients that guess: counts wrong tokens by the address that they came from."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        # Hashes of what was wrong, and the time at which they are forgotten; the address that erred last at the end.
        self._wrong: OrderedDict[str, tuple[set[int], float]] = OrderedDict()

    def record_failure(self, address: str, shown: object) -> None:
        """Count a wrong token from an address; the same one again, as of an old page, is no further guess."""
        key = client_key(address)
        wrong, until_s = self._known(key)
        wrong.add(hash(shown))
        # The whole wait begins again with each further token.
        if len(wrong) == 1 or len(wrong) >= MAX_WRONG:
            until_s = self._clock() + WINDOW_S
        self._wrong[key] = wrong, until_s
        self._wrong.move_to_end(key)
        if len(self._wrong) > MAX_ADDRESSES:
            self._wrong.popitem(last=False)

    def refusal(self, address: str) -> str | None:
        """Return the reason why no token from this address is checked now, None when tokens are checked."""
        left_s = self.wait_s(address)
        if left_s <= 0.0:
            return None
        return f"{MAX_WRONG} wrong tokens came from this address, the limit is {MAX_WRONG}; try again in {left_s:.0f} s"

    def wait_s(self, address: str) -> float:
        """Return the time for which no token from this address is checked [s]."""
        wrong, until_s = self._known(client_key(address))
        return until_s - self._clock() if len(wrong) >= MAX_WRONG else 0.0

    def _known(self, key: str) -> tuple[set[int], float]:
        wrong, until_s = self._wrong.get(key, (set(), 0.0))
        if wrong and self._clock() >= until_s:
            del self._wrong[key]
            return set(), 0.0
        return wrong, until_s


def digest_of(token: str) -> bytes:
    """Return the form in which tokens are kept and compared (SHA-256)."""
    return sha256(token.encode(errors="surrogatepass")).digest()


def identities(settings: AccessSettings) -> Iterator[tuple[str, Identity]]:
    if settings.token is not None:
        yield settings.token.get_secret_value(), Identity(TOKEN_NAME, Role.ADMIN)
    for key, role in _ROLES.items():
        for name, token in getattr(settings, key).items():
            yield token.get_secret_value(), Identity(name, role)


def _read(file: Path) -> AccessSettings:
    with contextlib.suppress(OSError):
        if file.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH):
            log.warning("access.token_file: %s can be read by other users of this machine; chmod 600 it", file)
    values = read_toml(file, "access.token_file:")
    if stray := sorted(values.keys() - _IN_FILE):
        raise ConfigurationError(f"access.token_file: {file} has {stray[0]}; it may have {', '.join(sorted(_IN_FILE))}")
    try:
        return AccessSettings(**values)
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"access.token_file: {file}: {key}: {sentence_of(first)}") from None
