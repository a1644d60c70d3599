"""Wrong tokens, by the address that they came from: whoever shows too many is not heard for a while."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

from server.gateway.entrance.addresses import peer

MAX_WRONG = 10
WINDOW_S = 60.0

# Addresses that are remembered, the latest; each costs a kilobyte.
MAX_ADDRESSES = 10_000


class WrongTokens:
    """Counts wrong tokens.

    Args:
        clock: monotonic time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # Hashes of what was wrong, and the time at which they are forgotten; the address that erred last at the end.
        self._wrong: OrderedDict[str, tuple[set[int], float]] = OrderedDict()

    def add(self, address: str, shown: object) -> None:
        """Count something wrong that was shown from an address; the same again is no further guess.

        A page or program with an old token tries it for ever, and must not shut its neighbours out.
        """
        key = peer(address)
        wrong, until_s = self._known(key)
        wrong.add(hash(shown))
        # From the last one that is heard on, the whole time is waited.
        if len(wrong) == 1 or len(wrong) >= MAX_WRONG:
            until_s = self._clock() + WINDOW_S
        self._wrong[key] = wrong, until_s
        self._wrong.move_to_end(key)
        if len(self._wrong) > MAX_ADDRESSES:
            self._wrong.popitem(last=False)

    def refusal(self, address: str) -> str | None:
        """Why no token from this address is looked at, if so."""
        left_s = self.wait_s(address)
        if left_s <= 0.0:
            return None
        return f"{MAX_WRONG} wrong tokens came from this address, the limit is {MAX_WRONG}; try again in {left_s:.0f} s"

    def wait_s(self, address: str) -> float:
        """How long no token from this address is looked at [s]."""
        wrong, until_s = self._known(peer(address))
        return until_s - self._clock() if len(wrong) >= MAX_WRONG else 0.0

    def _known(self, key: str) -> tuple[set[int], float]:
        wrong, until_s = self._wrong.get(key, (set(), 0.0))
        if wrong and self._clock() >= until_s:
            del self._wrong[key]
            return set(), 0.0
        return wrong, until_s
