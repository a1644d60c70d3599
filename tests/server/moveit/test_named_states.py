from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping

import pytest

from robot.description import model
from server.errors import ServiceError
from server.moveit import named_states
from server.moveit.named_states import MAX_NAME_LENGTH, NamedStates, Positions

ROBOT = model.builtin()
BENT = {"elbow_flex": 0.4}


class Kept(NamedStates):
    """States, and what was kept of them last."""

    def __init__(self, saved: Mapping[str, Positions] | None = None) -> None:
        self.kept: Mapping[str, Positions] = {}
        self.changes = 0
        super().__init__(ROBOT, "arm", saved or {}, self._take)
        self.on_change(self._count)

    async def _take(self, saved: Mapping[str, Positions]) -> None:
        self.kept = saved

    def _count(self) -> None:
        self.changes += 1


@pytest.fixture
def states() -> Kept:
    return Kept()


async def test_a_saved_state_is_found_whatever_its_case_and_blanks_kept_and_told_of(states: Kept) -> None:
    await states.save(" Over  the table", BENT)
    assert states.find("overthe TABLE") == ("Over the table", BENT)
    assert states.kept == {"Over the table": BENT}
    assert states.changes == 1
    assert "Over the table" in states.names


async def test_the_states_of_the_description_are_there_from_the_start(states: Kept) -> None:
    assert states.names == ["extended", "home", "ready", "rest"]
    assert states.find("Ready") == ("ready", ROBOT.named_states["arm"]["ready"])


async def test_a_state_saved_again_takes_the_place_of_the_first(states: Kept) -> None:
    await states.save("mine", BENT)
    await states.save("MINE", {"elbow_flex": 0.5})
    assert states.saved == {"MINE": {"elbow_flex": 0.5}}


async def test_a_deleted_state_is_gone(states: Kept) -> None:
    await states.save("mine", BENT)
    await states.delete("Mine")
    assert states.find("mine") is None
    assert states.kept == {}


async def test_a_renamed_state_keeps_its_joints_and_may_change_its_case(states: Kept) -> None:
    await states.save("mine", BENT)
    await states.rename("mine", "Mine")
    await states.rename("mine", "yours")
    assert states.saved == {"yours": BENT}


@pytest.mark.parametrize("name", ["home", " HO me"])
async def test_a_state_of_the_description_is_neither_overwritten_nor_changed(states: Kept, name: str) -> None:
    await states.save("mine", BENT)
    changes: list[Callable[[], Awaitable[None]]] = [
        lambda: states.save(name, BENT),
        lambda: states.delete(name),
        lambda: states.rename(name, "new"),
        lambda: states.rename("mine", name),
    ]
    for change in changes:
        with pytest.raises(ServiceError, match=r"home|HO me"):
            await change()
    assert states.changes == 1


@pytest.mark.parametrize("name", ["", "   ", "a" * (MAX_NAME_LENGTH + 1), "a\x07b"])
async def test_a_name_that_nobody_could_ask_for_is_refused(states: Kept, name: str) -> None:
    with pytest.raises(ServiceError, match=f"1 to {MAX_NAME_LENGTH}"):
        await states.save(name, BENT)


@pytest.mark.parametrize(
    ("positions_rad", "words"),
    [({}, "no joint"), ({"knee": 0.1}, "no joint 'knee'"), ({"elbow_flex": math.nan}, "elbow_flex .* not nan")],
)
async def test_a_state_that_the_arm_cannot_have_is_refused(states: Kept, positions_rad: Positions, words: str) -> None:
    with pytest.raises(ServiceError, match=words):
        await states.save("mine", positions_rad)


async def test_an_unknown_state_is_refused_with_those_that_are_known(states: Kept) -> None:
    with pytest.raises(ServiceError, match="extended, home, ready, rest"):
        await states.delete("mine")


async def test_the_number_of_saved_states_is_bounded(states: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(named_states, "MAX_STATES", 1)
    await states.save("a", BENT)
    await states.save("A", BENT)
    with pytest.raises(ServiceError, match="the limit is 1"):
        await states.save("b", BENT)


async def test_what_cannot_be_kept_is_not_there_either() -> None:
    async def full(_saved: Mapping[str, Positions]) -> None:
        raise ServiceError("no space")

    states = NamedStates(ROBOT, "arm", {}, full)
    with pytest.raises(ServiceError):
        await states.save("mine", BENT)
    assert states.find("mine") is None


def test_states_kept_for_another_arm_are_left_out() -> None:
    states = Kept({"mine": BENT, "its": {"knee": 0.1}, "home": BENT})
    assert states.saved == {"mine": BENT}


@pytest.mark.parametrize(("name", "meant"), [("redy", "ready"), ("Hom", "home"), ("moon base", None)])
async def test_a_name_with_a_slip_is_understood_for_advice(states: Kept, name: str, meant: str | None) -> None:
    assert states.nearest_name(name) == meant
