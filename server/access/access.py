"""Access as a whole: what the settings make of it for each client."""

from __future__ import annotations

import time
from collections.abc import Callable

from protocol.operations import Auth
from server.access.globs import Globs
from server.access.guard import Guard, Shared
from server.access.lease import Lease
from server.access.proofs import Proof, Proofs
from server.access.rates import Rate
from server.access.roles import Identity
from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.graph.node import Node

# Whoever limits services wants clients to find out what there is all the same (rosbridge_server).
ALWAYS_SERVICES = ("/rosapi/*",)


class Access:
    """Who may do what.

    Args:
        settings: the section ``access``.
        clock: monotonic time [s].
        wall_clock: seconds since the epoch.

    Attributes:
        tokens: who is who.
        lease: who drives the arm.
        params: which parameters clients may use.

    Raises:
        ConfigurationError: the tokens cannot be used.
    """

    def __init__(
        self,
        settings: AccessSettings,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:
        self.tokens = Tokens.of(settings)
        self.lease = Lease(settings.control, settings.control_idle_s, wall_clock)
        self.params = Globs("access.params_glob", settings.params_glob)
        self._settings = settings
        self._clock = clock
        self._wall_clock = wall_clock
        self._proofs = Proofs(self.tokens)
        self._shared = Shared(
            Globs("access.topics_glob", settings.topics_glob),
            Globs("access.services_glob", settings.services_glob, ALWAYS_SERVICES),
            self.lease,
        )

    def guard(self, node: Node) -> Guard:
        """What this client may do, as long as it is there."""
        return Guard(node, self._shared, Rate(self._settings.goals_per_s, self._settings.goal_burst), self._clock)

    def identify(self, shown: Auth) -> Identity | str:
        """Who a client is that says ``auth``, or a sentence why it is nobody."""
        if shown.token is not None:
            return self.tokens.identify(shown.token) or "field token: it is none of the tokens here"
        if shown.mac is None:
            return "wanted the field token, or rosauth's mac, client, dest, rand, t, level and end; got neither"
        proof = Proof(shown.mac, shown.client, shown.dest, shown.rand, int(shown.t), shown.level, int(shown.end))
        return self._proofs.identify(proof, self._wall_clock())


def unlimited() -> Access:
    """Access to a server on which everybody may do everything at any time."""
    return Access(AccessSettings(control="shared"))
