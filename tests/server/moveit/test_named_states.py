import json
import math
import os
from pathlib import Path
from typing import Any

import pytest

from robot import files
from server.errors import ServiceError
from server.execution.monitors import CurrentState
from server.graph.services import Response
from server.graph.topics import Graph
from server.moveit import named_states
from server.moveit.named_states import (
    MAX_NAME_LENGTH,
    NAMED_STATES_TOPIC,
    NamedStates,
    NamedStatesServices,
    States,
    default_path,
)
from tests.helpers.fake_arm import JOINTS, ROBOT, FakeArm
from tests.helpers.graph import called, listen
from tests.helpers.messages import REGISTRY

BENT = {"elbow_flex": 0.4}
ONE_NAME = {"joint_state": {"name": ["elbow_flex"], "position": []}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "armbridge" / "states.json"


def opened(path: Path) -> NamedStates:
    """The states of a server that has just started."""
    return NamedStates(ROBOT, "arm", path)


def kept(path: Path) -> Any:
    return json.loads(path.read_text())["states"]


@pytest.fixture
def states(path: Path) -> NamedStates:
    return opened(path)


async def test_a_saved_state_is_found_whatever_its_case_and_blanks_and_kept(states: NamedStates, path: Path) -> None:
    changes: list[int] = []
    states.on_change(lambda: changes.append(1))
    await states.save(" Over  the table", BENT)
    assert states.find("overthe TABLE") == ("Over the table", BENT)
    assert kept(path) == {"Over the table": BENT}
    assert changes == [1]
    assert "Over the table" in states.names()


@pytest.mark.parametrize("name", ["home", " HO me"])
async def test_a_state_of_the_description_is_neither_overwritten_nor_changed(states: NamedStates, name: str) -> None:
    await states.save("mine", BENT)
    for change in (states.save(name, BENT), states.delete(name)):
        with pytest.raises(ServiceError, match=r"home|HO me"):
            await change
    assert states.saved == {"mine": BENT}


async def test_an_invalid_name_or_state_or_one_too_many_is_refused(states: NamedStates, monkeypatch: Any) -> None:
    monkeypatch.setattr(named_states, "MAX_STATES", 1)
    await states.save("a", BENT)
    await states.save("A", BENT)
    for name, positions_rad, words in (
        *((name, BENT, f"1 to {MAX_NAME_LENGTH}") for name in ("", "   ", "a" * (MAX_NAME_LENGTH + 1), "a\x07b")),
        ("mine", {}, "no joint"),
        ("mine", {"knee": 0.1}, "no joint 'knee'"),
        ("mine", {"elbow_flex": math.nan}, "elbow_flex .* not nan"),
        ("one more", BENT, "the limit is 1"),
    ):
        with pytest.raises(ServiceError, match=words):
            await states.save(name, positions_rad)


async def test_two_servers_keep_what_the_other_saved_also_of_another_arm_and_know_what_it_deleted(path: Path) -> None:
    with files.locked(path):
        files.replace(path, b'{"states": {"its": {"knee": 0.1}}}')
    one, other = opened(path), opened(path)
    await one.save("mine", BENT)
    await other.save("yours", {"elbow_flex": 0.5})
    assert kept(path).keys() == {"its", "mine", "yours"}
    assert other.saved.keys() == {"mine", "yours"}
    await one.delete("mine")
    with pytest.raises(ServiceError, match="no state 'mine'"):
        await other.delete("mine")
    assert kept(path).keys() == {"its", "yours"}


async def test_a_file_of_another_process_is_refused_with_its_name(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "LOCK_TIMEOUT_S", 0.0)
    holder = files.FileLock(path)
    holder.acquire()
    with pytest.raises(ServiceError, match=rf"states\.json.* is in use by armbridge \(process {os.getpid()}\)"):
        await opened(path).save("mine", BENT)
    holder.release()
    await opened(path).save("mine", BENT)


async def test_a_file_that_cannot_be_read_or_written_is_an_error(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    states = opened(path)
    await states.save("mine", BENT)

    def unreadable(_states: NamedStates) -> States:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(NamedStates, "_read", unreadable)
        with pytest.raises(ServiceError, match=r"cannot be kept: .*: Input/output error"):
            await states.save("yours", BENT)
    path.with_name(f".{path.name}.new").mkdir()
    with pytest.raises(ServiceError, match=str(path)):
        await states.save("yours", BENT)
    assert kept(path) == {"mine": BENT}
    assert states.find("yours") is None


BROKEN = [
    "{",
    '{"states": []}',
    "{}",
    '{"states": {"mine": {"elbow_flex": "much"}}}',
    '{"states": {"mine": {"elbow_flex": true}}}',
]


@pytest.mark.parametrize("content", BROKEN, ids=range(len(BROKEN)))
def test_an_invalid_file_is_logged_and_renamed(path: Path, content: str, caplog: pytest.LogCaptureFixture) -> None:
    path.parent.mkdir()
    path.write_text(content)
    assert opened(path).saved == {}
    assert str(path) in caplog.text
    assert path.with_name(f"{path.name}.broken").read_text() == content
    assert not path.exists()


def test_a_file_that_cannot_be_read_is_logged_and_left(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.mkdir(parents=True)
    assert opened(path).saved == {}
    assert str(path) in caplog.text
    assert path.is_dir()


@pytest.mark.parametrize(
    ("environment", "directory"), [({"XDG_DATA_HOME": "/data"}, "/data"), ({"HOME": "/me"}, "/me/.local/share")]
)
def test_states_are_kept_in_the_users_data_directory(environment: dict[str, str], directory: str) -> None:
    assert default_path("named_states", ROBOT, environment) == Path(directory, "armbridge", "named_states_so101.json")


class Office:
    """The services, for an arm that says where it is."""

    def __init__(self, states: NamedStates) -> None:
        self.graph, self.arm = Graph(REGISTRY), FakeArm(None)
        NamedStatesServices(self.graph, ROBOT, states, CurrentState(self.arm))
        self.heard = listen(self.graph, NAMED_STATES_TOPIC)

    async def call(self, service: str, **request: Any) -> Response:
        return await called(self.graph, service, **request)


@pytest.fixture
async def office(states: NamedStates) -> Office:
    return Office(states)


async def test_the_present_positions_or_a_state_in_the_request_are_saved_and_published(office: Office) -> None:
    office.arm.put(**dict.fromkeys(JOINTS, 0.25))
    assert (await office.call("/save_robot_state", name="mine")).values == {"success": True}
    told = json.loads(office.heard[-1]["data"])
    assert told["mine"] == {"saved": True, "joints": dict.fromkeys(JOINTS, 0.25)}
    assert not told["home"]["saved"]
    state = {"joint_state": {"name": ["elbow_flex"], "position": [0.4]}}
    assert (await office.call("/save_robot_state", name="Mine", state=state)).ok
    assert json.loads(office.heard[-1]["data"])["Mine"] == {"saved": True, "joints": {"elbow_flex": 0.4}}


async def test_states_are_listed_and_deleted(office: Office) -> None:
    async def listed() -> Any:
        return (await office.call("/list_robot_states", robot="so101")).values["states"]

    office.arm.put()
    await office.call("/save_robot_state", name="mine")
    assert await listed() == ["extended", "home", "mine", "ready", "rest"]
    assert (await office.call("/delete_robot_state", name="mine")).ok
    assert await listed() == ["extended", "home", "ready", "rest"]


async def test_what_cannot_be_done_is_refused(office: Office) -> None:
    for service, request_, sentence in (
        ("/save_robot_state", {"name": "mine"}, "joint positions unknown"),
        ("/save_robot_state", {"name": "mine", "state": ONE_NAME}, "1 names and 0 positions"),
        ("/list_robot_states", {"regex": "r.*"}, "regex: must be empty, for all names, not 'r.*'"),
        ("/list_robot_states", {"robot": "panda"}, "'so101'"),
        ("/delete_robot_state", {"name": "nowhere"}, "extended, home"),
    ):
        answer = await office.call(service, **request_)
        assert not answer.ok, service
        assert sentence in answer.values
