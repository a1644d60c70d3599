"""Proofs of a token that do not show it: the MAC of rosauth, which the op ``auth`` of rosbridge carries."""

from __future__ import annotations

import hmac
from collections import OrderedDict
from dataclasses import dataclass
from hashlib import sha512

from server.access.roles import Identity
from server.access.tokens import Tokens

# As in rosauth: clocks may differ by so much, and a proof is good for so long.
GOOD_FOR_S = 5.0

# Only right proofs are kept, each for twice `GOOD_FOR_S`.
MAX_KEPT = 10_000


@dataclass(frozen=True)
class Proof:
    """What a client says in ``auth``.

    Attributes:
        mac: SHA-512 of the token and the other fields one after the other, as hexadecimal text.
        client: the client's address, as it calls it.
        dest: the server's.
        rand: a text that no other proof has.
        t: when it was made [s since the epoch].
        level: a role as rosauth knows them; that of the token counts.
        end: until when it is good [s since the epoch].
    """

    mac: str
    client: str
    dest: str
    rand: str
    t: int
    level: str
    end: int

    def made_with(self, token: str) -> bool:
        """Whether this token is in it."""
        text = f"{token}{self.client}{self.dest}{self.rand}{self.t}{self.level}{self.end}"
        expected = sha512(text.encode(errors="surrogatepass")).hexdigest()
        return hmac.compare_digest(expected.encode(), self.mac.lower().encode(errors="surrogatepass"))


class Proofs:
    """Says whose a proof is; each is good once.

    Args:
        tokens: the secrets in them.
    """

    def __init__(self, tokens: Tokens) -> None:
        self._tokens = tokens
        self._seen: OrderedDict[str, float] = OrderedDict()

    def identify(self, proof: Proof, now_s: float) -> Identity | str:
        """Whose token was used, or a sentence why it does not count.

        Args:
            proof: as it came.
            now_s: seconds since the epoch.
        """
        if abs(now_s - proof.t) > GOOD_FOR_S:
            return f"field t: the proof was made {now_s - proof.t:+.0f} s ago by this server's clock, the limit is 5"
        if now_s > proof.end:
            return f"field end: the proof ended {now_s - proof.end:.0f} s ago by this server's clock"
        owner = None
        for token, identity in self._tokens.secrets():
            if proof.made_with(token):
                owner = identity
        if owner is None:
            return "field mac: it was made with none of the tokens here"
        # Not by rand: fields stand in the text without a sign between them, and so could lend one another characters.
        return self._once(proof.mac.lower(), now_s) or owner

    def _once(self, mac: str, now_s: float) -> str | None:
        while self._seen and next(iter(self._seen.values())) < now_s:
            self._seen.popitem(last=False)
        if mac in self._seen:
            return "field mac: this proof was used before; each is good once"
        if len(self._seen) >= MAX_KEPT:
            return f"field mac: {MAX_KEPT} proofs were used within {2 * GOOD_FOR_S:g} s, the limit; try again later"
        self._seen[mac] = now_s + 2 * GOOD_FOR_S
        return None
