from __future__ import annotations

from server.graph.permissions import NameFilter


def test_patterns_are_those_of_a_shell() -> None:
    names = NameFilter("access.topics_glob", ["/arm[12]/*", "/joint?"])
    for name, fits in {"/arm1/a/b": True, "/arm3/a": False, "/joint1": True, "/joint12": False}.items():
        assert (names.refusal("topic", name) is None) is fits
