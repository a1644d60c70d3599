"""What the log is told of those who are refused: once each, for whoever is refused comes again and again."""

from __future__ import annotations

import logging
from collections import Counter

from protocol.errors import one_line, shorten

log = logging.getLogger("armbridge.gateway")

# Refusals that the log is told of; what they are about is chosen by whoever is refused.
MAX_TOLD = 100


class RefusalLog:
    """Tells of each refusal once.

    Attributes:
        counts: how many there were of each kind, told or not.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._told: set[tuple[str, str]] = set()

    def tell(self, kind: str, value: str, sentence: str) -> None:
        """Warn of a refusal, unless it was told already.

        Args:
            kind: what is refused.
            value: which one of its kind.
            sentence: what there is to say.
        """
        self.counts[kind] += 1
        key = kind, shorten(value)
        if key in self._told or len(self._told) > MAX_TOLD:
            return
        self._told.add(key)
        if len(self._told) > MAX_TOLD:
            log.warning("refused: %d of them were told; further ones are not", MAX_TOLD)
        else:
            log.warning("refused: %s", one_line(sentence))
