from __future__ import annotations

from pathlib import Path

import pytest

from robot.description import model
from server.errors import ServiceError
from server.moveit.named_states_file import NamedStatesFile, default_path

STATES = {"mine": {"elbow_flex": 0.4, "gripper": 1.0}, "": {}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "armbridge" / "states.json"


async def test_what_is_saved_is_read_again(path: Path) -> None:
    await NamedStatesFile(path).save(STATES)
    assert NamedStatesFile(path).load() == STATES
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_without_a_file_there_are_no_states(path: Path) -> None:
    assert NamedStatesFile(path).load() == {}


BROKEN = {
    "not JSON": "{",
    "nests too deep": "[" * 100_000,
    "not UTF-8": "\udcff",
    "another form": '{"states": []}',
    "no states": "{}",
    "a word for a number": '{"states": {"mine": {"elbow_flex": "much"}}}',
    "true for a number": '{"states": {"mine": {"elbow_flex": true}}}',
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_file_is_told_of_and_set_aside(path: Path, content: str, caplog: pytest.LogCaptureFixture) -> None:
    path.parent.mkdir()
    octets = content.encode("utf-8", "surrogateescape")
    path.write_bytes(octets)
    assert NamedStatesFile(path).load() == {}
    assert str(path) in caplog.text
    assert path.with_name(f"{path.name}.broken").read_bytes() == octets
    assert not path.exists()


async def test_a_file_that_cannot_be_written_is_a_refusal_and_the_old_one_stays(path: Path) -> None:
    file = NamedStatesFile(path)
    await file.save(STATES)
    path.with_name(f"{path.name}.new").mkdir()
    with pytest.raises(ServiceError, match=str(path)):
        await file.save({})
    assert file.load() == STATES


def test_a_file_that_cannot_be_read_is_told_of_and_left(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.mkdir(parents=True)
    assert NamedStatesFile(path).load() == {}
    assert str(path) in caplog.text
    assert path.is_dir()


@pytest.mark.parametrize(
    ("environment", "directory"), [({"XDG_DATA_HOME": "/data"}, "/data"), ({"HOME": "/me"}, "/me/.local/share")]
)
def test_states_are_kept_in_the_users_data_directory(environment: dict[str, str], directory: str) -> None:
    assert default_path(model.builtin(), environment) == Path(directory, "armbridge", "named_states_so101.json")
