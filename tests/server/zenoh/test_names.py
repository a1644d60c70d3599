from __future__ import annotations

from server.zenoh.names import Namespace, Patterns


def test_a_pattern_fits_whole_names_with_all_that_lies_below() -> None:
    patterns = Patterns(["/joint_states", "/arm/*"])
    names = ("/joint_states", "/joint_states2", "/arm/a/b", "/arm", "/armada")
    assert [name for name in names if patterns.fit(name)] == ["/joint_states", "/arm/a/b"]


def test_no_pattern_fits_nothing() -> None:
    assert not Patterns([]).fit("/joint_states")


def test_further_names_go_along_with_the_first_pattern() -> None:
    assert Patterns(["/goal"], lambda name: name == "/stop").fit("/stop")
    assert not Patterns([], lambda name: name == "/stop").fit("/stop")


def test_a_name_that_is_a_pattern_of_keys_is_never_shared() -> None:
    assert not Patterns(["*"]).fit("/**")


def test_names_get_the_namespace_on_their_way_out_and_lose_it_on_their_way_in() -> None:
    namespace = Namespace("/arm1")
    assert namespace.outside("/joint_states") == "/arm1/joint_states"
    assert namespace.inside("/arm1/joint_states") == "/joint_states"


def test_names_of_other_namespaces_come_in_as_they_are() -> None:
    namespace = Namespace("/arm1")
    assert namespace.inside("/arm2/joint_states") == "/arm2/joint_states"
    assert namespace.inside("/arm12/joint_states") == "/arm12/joint_states"
    assert not namespace.has("/arm12/joint_states")


def test_without_a_namespace_names_are_the_same_on_both_sides() -> None:
    namespace = Namespace("")
    assert namespace.outside("/a") == namespace.inside("/a") == "/a"
    assert namespace.has("/a")
