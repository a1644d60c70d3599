from __future__ import annotations

import json
from typing import Any

import pytest

from server.access.permissions import NameFilter
from server.errors import ServiceError
from server.rosapi import parameters
from server.rosapi.parameters import MAX_PARAMETER_BYTES, Parameters
from server.rosapi.question import Question


class Kept(Parameters):
    """Parameters, asked as by a service."""

    def ask(self, service: str, **request: Any) -> dict[str, Any]:
        return self.answers[service][1](Question(request, "ros2"))


@pytest.fixture
def kept() -> Kept:
    return Kept()


def test_a_parameter_is_kept_until_it_is_deleted(kept: Kept) -> None:
    assert kept.ask("get_param", name="/speed", default_value="0.1") == {"value": "0.1"}
    kept.ask("set_param", name="/speed", value="0.5")
    assert kept.ask("get_param", name="/speed", default_value="") == {"value": "0.5"}
    assert kept.ask("search_param", name="/speed") == {"global_name": "/speed"}
    kept.ask("delete_param", name="/speed")
    assert kept.ask("has_param", name="/speed") == {"exists": False}
    assert kept.ask("search_param", name="/speed") == {"global_name": ""}


@pytest.mark.parametrize("value", ["", "{", "[" * 200_000])
def test_what_is_no_json_is_refused(kept: Kept, value: str) -> None:
    with pytest.raises(ServiceError, match="value: must be JSON text"):
        kept.ask("set_param", name="/speed", value=value)
    assert kept.ask("get_param_names") == {"names": []}


def test_the_servers_own_parameters_are_there_for_clients(kept: Kept) -> None:
    kept.keep("/robot_description", '"<robot/>"')
    assert kept.ask("get_param", name="/robot_description", default_value="") == {"value": '"<robot/>"'}
    kept.ask("delete_param", name="/robot_description")
    assert kept.ask("get_param_names") == {"names": []}


def test_the_number_of_parameters_is_bounded(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameters, "MAX_PARAMETERS", 2)
    for name in ("/a", "/b", "/a"):
        kept.ask("set_param", name=name, value="1")
    with pytest.raises(ServiceError, match="there are 2 parameters already"):
        kept.ask("set_param", name="/c", value="1")


def test_all_parameters_together_are_bounded_in_bytes_and_a_deleted_one_makes_room(kept: Kept) -> None:
    half = json.dumps("x" * (MAX_PARAMETER_BYTES // 2))
    kept.ask("set_param", name="/a", value=half)
    kept.ask("set_param", name="/a", value=half)
    with pytest.raises(ServiceError, match=f"the limit is {MAX_PARAMETER_BYTES}"):
        kept.ask("set_param", name="/b", value=half)
    kept.ask("delete_param", name="/a")
    kept.ask("delete_param", name="/a")
    kept.ask("set_param", name="/b", value=half)
    assert kept.ask("get_param_names") == {"names": ["/b"]}


def test_long_names_count_too(kept: Kept) -> None:
    with pytest.raises(ServiceError, match="the limit is"):
        kept.ask("set_param", name="x" * MAX_PARAMETER_BYTES, value="1")


class TestGlobs:
    @pytest.fixture
    def some(self) -> Kept:
        some = Kept(NameFilter("access.params_glob", ["/open/*"]))
        some.keep("/robot_description", '"<robot/>"')
        some.ask("set_param", name="/open/speed", value="1")
        return some

    def test_parameters_that_fit_are_open(self, some: Kept) -> None:
        assert some.ask("get_param", name="/open/speed", default_value="") == {"value": "1"}

    @pytest.mark.parametrize("service", ["get_param", "set_param", "has_param", "delete_param", "search_param"])
    @pytest.mark.parametrize("name", ["/robot_description", "//open/speed", "open/speed"])
    def test_others_are_refused_with_what_to_set(self, some: Kept, service: str, name: str) -> None:
        with pytest.raises(ServiceError, match=r"fits no pattern of access\.params_glob"):
            some.ask(service, name=name, value="0", default_value="")

    def test_others_are_not_listed(self, some: Kept) -> None:
        assert some.ask("get_param_names") == {"names": ["/open/speed"]}
