"""All conformance cases in process, and on sockets a selection that has every feature of them."""

from typing import Any

import pytest

from tests.conformance.cases import cases, covering_cases, features_of, lets_time_pass, play
from tests.conformance.players import OverTcp, OverWebSockets, play_on
from tests.helpers.gateway import InProcess


def by_one_encoding(case: dict[str, Any]) -> bool:
    """Return true for a case whose clients each send JSON objects alone, or BSON documents alone."""
    sent = {(step["client"], key) for step in case["steps"] for key in step if key.startswith("send")}
    return {kind for _, kind in sent} <= {"send", "send_bson"} and len(sent) == len({client for client, _ in sent})


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["name"])
async def test_a_case_in_process(case: dict[str, Any]) -> None:
    options = {option: case.get(option, False) for option in ("relay_unknown_types", "rosapi", "interfaces")}
    await play(case, InProcess(**options))


@pytest.mark.parametrize("case", covering_cases(), ids=lambda case: case["name"])
async def test_a_case_over_websockets(case: dict[str, Any]) -> None:
    await play_on(OverWebSockets, case)


@pytest.mark.parametrize("case", covering_cases(by_one_encoding), ids=lambda case: case["name"])
async def test_a_case_over_raw_tcp(case: dict[str, Any]) -> None:
    await play_on(OverTcp, case)


def test_the_cases_on_sockets_have_every_feature_of_those_that_let_no_time_pass() -> None:
    wanted = {feature for case in cases() if not lets_time_pass(case) for feature in features_of(case)}
    assert {feature for case in covering_cases() for feature in features_of(case)} == wanted
    assert len(wanted) > 150
    assert len(covering_cases()) < len(cases()) / 2
