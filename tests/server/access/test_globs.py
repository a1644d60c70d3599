from __future__ import annotations

import pytest

from server.access.globs import Globs


def test_without_patterns_every_name_fits() -> None:
    assert Globs("access.topics_glob").refusal("topic", "/any") is None


def test_a_name_that_fits_none_is_refused_with_what_to_set() -> None:
    refusal = Globs("access.topics_glob", ["/a*"]).refusal("topic", "/b")
    assert refusal == "topic /b: fits no pattern of access.topics_glob; add one there to open it"


def test_what_is_always_open_stays_so_beside_patterns() -> None:
    globs = Globs("access.services_glob", ["/a"], ["/rosapi/*"])
    assert globs.refusal("service", "/rosapi/topics") is None
    assert globs.refusal("service", "/other") is not None


@pytest.mark.parametrize(
    "name", ["//arm/state", "/ARM/state", "/arm/state\n", "/x/arm/state", "/arm/stat", "arm/state"]
)
def test_a_pattern_is_not_evaded(name: str) -> None:
    globs = Globs("access.topics_glob", ["/arm/state"])
    assert globs.refusal("topic", "/arm/state") is None
    assert globs.refusal("topic", name) is not None


def test_patterns_are_those_of_a_shell() -> None:
    globs = Globs("access.topics_glob", ["/arm[12]/*", "/joint?"])
    for name, fits in {"/arm1/a/b": True, "/arm3/a": False, "/joint1": True, "/joint12": False}.items():
        assert (globs.refusal("topic", name) is None) is fits
