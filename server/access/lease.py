"""Control of the arm: one client drives at a time, until it leaves, gives it back or asks for nothing any more."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal, TypeAlias

from server.access.roles import Role
from server.graph.node import Node

Policy: TypeAlias = Literal["lease", "shared"]

RELEASE_SERVICE = "/arm/release_control"

# Who has released another's control may take it first for so long, however often the other asks.
RESERVED_S = 3.0


class Lease:
    """Who drives the arm.

    Args:
        policy: whether one drives, or all may.
        idle_s: it is free for others when its holder has asked for nothing for so long [s].
        wall_clock: seconds since the epoch.

    Attributes:
        policy: as given.
        holder: who drives; None when nobody does.
        since_s: when the holder began [s since the epoch].
        busy: whether a goal is worked on; while one is, nobody idles.
        on_change: called when there is another holder, or none.
    """

    def __init__(self, policy: Policy, idle_s: float, wall_clock: Callable[[], float]) -> None:
        self.policy = policy
        self.holder: Node | None = None
        self.since_s = 0.0
        self.busy: Callable[[], object] = lambda: False
        self.on_change: Callable[[], None] = lambda: None
        self._idle_limit_s = idle_s
        self._wall_clock = wall_clock
        self._heard_s = 0.0
        self._reserved: tuple[Node, float] | None = None

    def drive(self, node: Node, now_s: float) -> str | None:
        """Take control, or keep it, to move the arm or to switch it.

        Args:
            node: who wants to.
            now_s: monotonic time [s].

        Returns:
            Why it may not; None when it may.
        """
        if self.policy == "shared" or not node.remote:
            return None
        if self.holder is not node:
            self.tick(now_s)
            if self.holder is not None:
                return self._refusal(self.holder, self.free_in_s(now_s))
            if (reserved := self._reservation(node, now_s)) is not None:
                return reserved
        self._heard_s = now_s
        self._set(node)
        return None

    def release(self, node: Node, now_s: float) -> str | None:
        """Give control back; who has shown a token with the role ADMIN may take it from another.

        Args:
            node: who wants to.
            now_s: monotonic time [s].

        Returns:
            Why it may not; None when nobody holds it any more.
        """
        if self.holder is None or self.holder is node:
            self._set(None)
            return None
        identity = node.identity
        if identity is not None and identity.by_token and identity.role >= Role.ADMIN:
            self._reserved = node, now_s + RESERVED_S
            self._set(None)
            return None
        return (
            f"{self.holder} controls the arm, not {node}; to take control from another, show a token of "
            "access.admin_tokens"
        )

    def leave(self, node: Node) -> None:
        """Forget a client that has left, or that may not drive any more."""
        if self._reserved is not None and self._reserved[0] is node:
            self._reserved = None
        if self.holder is node:
            self._set(None)

    def tick(self, now_s: float) -> None:
        """See whether the holder still wants something, at a monotonic time [s]."""
        if self.holder is None:
            return
        if self.busy():
            self._heard_s = now_s
        elif now_s - self._heard_s >= self._idle_limit_s:
            self._set(None)

    def idle_s(self, now_s: float) -> float:
        """For how long the holder has asked for nothing [s], at a monotonic time [s]."""
        return 0.0 if self.holder is None else max(0.0, now_s - self._heard_s)

    def free_in_s(self, now_s: float) -> float:
        """When the arm is free if its holder asks for nothing more [s], at a monotonic time [s]."""
        return self._idle_limit_s - self.idle_s(now_s)

    def _reservation(self, node: Node, now_s: float) -> str | None:
        """Why the arm, which nobody holds, is not for this client yet; the first to take it ends that."""
        if self._reserved is not None:
            first, until_s = self._reserved
            if node is not first and now_s < until_s:
                return f"{first} has taken control from another; it is free in {math.ceil(until_s - now_s)} s"
            self._reserved = None
        return None

    def _set(self, holder: Node | None) -> None:
        if holder is self.holder:
            return
        self.holder = holder
        self.since_s = self._wall_clock()
        self.on_change()

    def _refusal(self, holder: Node, left_s: float) -> str:
        since = datetime.fromtimestamp(self.since_s, UTC).strftime("%H:%M:%S UTC")
        return (
            f"{holder} has controlled the arm since {since}; it is free when that client leaves, calls "
            f"{RELEASE_SERVICE}, or asks for nothing for another {math.ceil(left_s)} s "
            f"(access.control_idle_s = {self._idle_limit_s:g})"
        )
