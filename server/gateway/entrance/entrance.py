"""Who may connect, and how: what the settings make of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.config import ServerSettings
from server.gateway.entrance.door import Door
from server.gateway.entrance.tls import Tls
from server.gateway.entrance.turnstile import ConnectionLimits


@dataclass(frozen=True)
class Pings:
    """How a client is found out whose machine is gone without a word.

    Attributes:
        interval_s: it is asked so often [s].
        timeout_s: it has so long to answer [s].
    """

    interval_s: float = 20.0
    timeout_s: float = 20.0


@dataclass(frozen=True)
class Entrance:
    """What stands between the port and the clients.

    Attributes:
        door: who gets in; by default everybody who addresses this machine.
        limits: how many may be connected.
        tls: the server's certificate; None for connections that are not encrypted.
        pings: how often clients are asked whether they are there.
    """

    door: Door = field(default_factory=Door)
    limits: ConnectionLimits = field(default_factory=ConnectionLimits)
    tls: Tls | None = None
    pings: Pings = field(default_factory=Pings)

    @classmethod
    def of(cls, server: ServerSettings, access: AccessSettings, tokens: Tokens) -> Entrance:
        """What the settings describe.

        Raises:
            ConfigurationError: the certificate cannot be used.
        """
        limits = ConnectionLimits(server.max_clients, server.max_clients_per_address, server.connections_per_s)
        pair = server.tls_certificate, server.tls_key
        tls = None if pair[0] is None or pair[1] is None else Tls(pair[0], pair[1])
        return cls(Door.of(access, tokens), limits, tls, Pings(server.ping_interval_s, server.ping_timeout_s))
