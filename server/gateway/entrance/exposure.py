"""The rule for addresses that others can reach: tokens, or an explicit word that there are none."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from server.access.roles import Role
from server.access.tokens import Tokens
from server.errors import ConfigurationError
from server.gateway.entrance.addresses import is_loopback

log = logging.getLogger("armbridge.gateway")


def check_exposure(host: str, addresses: Iterable[str], tokens: Tokens, *, insecure: bool) -> None:
    """Hold the addresses to listen on against the rule; what is left open is warned of at each start.

    Args:
        host: what the addresses were found for.
        addresses: IP addresses, all of them.
        tokens: who may come.
        insecure: whether ``access.insecure`` is set.

    Raises:
        ConfigurationError: others could connect, and nobody has said that they may.
    """
    reachable = next((address for address in addresses if not is_loopback(address)), None)
    if reachable is None:
        return
    where = host if host == reachable else f"{host or 'every address'} ({reachable})"
    anonymous = tokens.anonymous
    may_move = anonymous is not None and anonymous.role > Role.VIEW
    if not insecure and not tokens.any:
        raise ConfigurationError(
            f"server.host: others can reach {where}, and nothing keeps them from moving the arm; set a token, as in"
            " ARMBRIDGE_ACCESS__TOKEN=..., or say --insecure if everybody there may"
        )
    if not insecure and may_move:
        raise ConfigurationError(
            f"access.without_token: others can reach {where} and move the arm without a token; set it to view or none,"
            " or say --insecure if everybody there may"
        )
    if anonymous is not None and may_move:
        log.warning(
            "INSECURE: whoever reaches %s may connect without a token as %s; docs/security.md says how to change that",
            where,
            anonymous.role.name.lower(),
        )
