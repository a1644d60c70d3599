from __future__ import annotations

import pytest

from server.graph.permissions import ANYONE, Identity, NameFilter, Role, display_name


def test_each_role_may_do_what_the_ones_before_it_may() -> None:
    assert Role.VIEW < Role.OPERATE < Role.ADMIN


def test_a_client_with_a_token_is_called_by_its_name() -> None:
    assert display_name(Identity("alice", Role.VIEW), "10.0.0.1:5") == "alice (10.0.0.1:5)"


def test_a_client_without_one_is_called_by_its_address() -> None:
    assert display_name(ANYONE, "10.0.0.1:5") == display_name(None, "10.0.0.1:5") == "client 10.0.0.1:5"


def test_only_a_client_with_a_token_is_known_by_it() -> None:
    assert Identity("alice", Role.ADMIN).by_token
    assert not ANYONE.by_token


def test_without_patterns_every_name_fits() -> None:
    assert NameFilter("access.topics_glob").refusal("topic", "/any") is None


def test_a_name_that_fits_none_is_refused_with_the_setting_to_change() -> None:
    refusal = NameFilter("access.topics_glob", ["/a*"]).refusal("topic", "/b")
    assert refusal == "topic /b: fits no pattern of access.topics_glob; add one there to open it"


def test_names_that_are_always_open_stay_open_beside_patterns() -> None:
    names = NameFilter("access.services_glob", ["/a"], ["/rosapi/*"])
    assert names.refusal("service", "/rosapi/topics") is None
    assert names.refusal("service", "/other") is not None


@pytest.mark.parametrize(
    "name", ["//arm/state", "/ARM/state", "/arm/state\n", "/x/arm/state", "/arm/stat", "arm/state"]
)
def test_a_pattern_is_not_evaded(name: str) -> None:
    names = NameFilter("access.topics_glob", ["/arm/state"])
    assert names.refusal("topic", "/arm/state") is None
    assert names.refusal("topic", name) is not None


def test_patterns_are_those_of_a_shell() -> None:
    names = NameFilter("access.topics_glob", ["/arm[12]/*", "/joint?"])
    for name, fits in {"/arm1/a/b": True, "/arm3/a": False, "/joint1": True, "/joint12": False}.items():
        assert (names.refusal("topic", name) is None) is fits
