from __future__ import annotations

from dataclasses import replace
from hashlib import sha512

import pytest

from server.access.proofs import MAX_KEPT, Proof, Proofs
from server.access.roles import Identity, Role
from server.access.tokens import Tokens

SECRET, OTHER = "one-0123456789abcdef", "two-0123456789abcdef"
ADA, SCREEN = Identity("ada", Role.ADMIN), Identity("screen", Role.VIEW)
NOW_S = 1_000_000.0


def proof(
    secret: str = SECRET, rand: str = "r", t: int = 1_000_000, level: str = "user", end: int = 1_000_100
) -> Proof:
    """As clients of rosauth make them."""
    mac = sha512(f"{secret}10.0.0.110.0.0.2{rand}{t}{level}{end}".encode()).hexdigest()
    return Proof(mac, "10.0.0.1", "10.0.0.2", rand, t, level, end)


@pytest.fixture
def proofs() -> Proofs:
    return Proofs(Tokens({SECRET: ADA, OTHER: SCREEN}, None))


def test_a_proof_made_with_a_token_says_whose_it_is(proofs: Proofs) -> None:
    assert proofs.identify(proof(), NOW_S) == ADA
    assert proofs.identify(proof(OTHER, rand="s"), NOW_S) == SCREEN


def test_a_proof_made_with_anything_else_does_not(proofs: Proofs) -> None:
    assert "none of the tokens" in str(proofs.identify(proof("guessed-0123456789"), NOW_S))


@pytest.mark.parametrize("field", ["client", "dest", "rand", "t", "level", "end"])
def test_a_proof_of_which_a_field_was_changed_does_not_count(proofs: Proofs, field: str) -> None:
    changed = {"t": 1_000_001, "end": 1_000_101}.get(field, "x")
    assert "field mac" in str(proofs.identify(replace(proof(), **{field: changed}), NOW_S))


def test_a_proof_is_good_once(proofs: Proofs) -> None:
    proofs.identify(proof(), NOW_S)
    assert "used before" in str(proofs.identify(proof(), NOW_S + 1.0))


def test_a_replayed_proof_in_which_fields_lend_one_another_characters_does_not_count(proofs: Proofs) -> None:
    shown = proof(rand="random")
    assert proofs.identify(shown, NOW_S) == ADA
    shifted = replace(shown, dest=shown.dest + "ran", rand="dom")
    assert "used before" in str(proofs.identify(shifted, NOW_S))
    assert "used before" in str(proofs.identify(replace(shown, mac=shown.mac.upper()), NOW_S))


def test_a_replayed_proof_does_not_count_at_its_last_moment_either(proofs: Proofs) -> None:
    late = proof(t=1_000_005)
    assert proofs.identify(late, NOW_S) == ADA
    assert "used before" in str(proofs.identify(late, NOW_S + 10.0))


@pytest.mark.parametrize("off_s", [-5.1, 5.1])
def test_a_proof_of_another_time_does_not_count(proofs: Proofs, off_s: float) -> None:
    assert "field t" in str(proofs.identify(proof(), NOW_S + off_s))


def test_a_proof_that_has_ended_does_not_count(proofs: Proofs) -> None:
    assert "field end" in str(proofs.identify(proof(end=1_000_000), NOW_S + 1.0))


def test_the_level_that_a_client_gives_itself_does_not_count(proofs: Proofs) -> None:
    assert proofs.identify(proof(OTHER, level="admin"), NOW_S) == SCREEN


def test_wrong_proofs_are_not_kept_and_right_ones_no_longer_than_they_are_good(proofs: Proofs) -> None:
    for number in range(3):
        proofs.identify(proof("guessed-0123456789", rand=str(number)), NOW_S)
    assert not proofs._seen
    proofs.identify(proof(rand="a"), NOW_S)
    proofs.identify(proof(rand="b", t=1_000_020), NOW_S + 20.0)
    assert list(proofs._seen) == [proof(rand="b", t=1_000_020).mac]


def test_no_more_proofs_are_taken_than_can_be_kept(proofs: Proofs) -> None:
    proofs._seen.update((str(number), NOW_S + 5.0) for number in range(MAX_KEPT))
    assert f"{MAX_KEPT} proofs" in str(proofs.identify(proof(), NOW_S))
