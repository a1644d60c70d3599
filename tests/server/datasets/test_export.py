"""Recordings exported as a LeRobotDataset, and the dataset read back by its documented schema."""

import base64
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from server.cli import main
from server.datasets import export as export_module
from server.datasets.export import Exported, ExportError, ExportOptions, camera_keys, export
from server.recording.files import RecordedMessage
from tests.server.datasets.conftest import JOINTS, Record, image, in_order, mark, stamp, state, states
from tests.server.recordings import REGISTRY, entry, record

pa = pytest.importorskip("pyarrow", reason="the extra [datasets] is not installed: no pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
av = pytest.importorskip("av", reason="the extra [datasets] is not installed: no av")

FPS = 10
KEY = "observation.images.camera"


def exported(output: Path, recording: Path, **options: Any) -> Exported:
    return export(ExportOptions(recording, output, **{"fps": FPS, **options}), REGISTRY, lambda _: None)


def rows(output: Path, path: str = "data/chunk-000/file-000.parquet") -> list[dict[str, Any]]:
    table: list[dict[str, Any]] = parquet.read_table(output / path).to_pylist()
    return table


def column(output: Path, name: str) -> np.ndarray[Any, Any]:
    return np.array([row[name] for row in rows(output)])


def info(output: Path) -> dict[str, Any]:
    contents: dict[str, Any] = json.loads((output / "meta/info.json").read_text())
    return contents


# Two episodes with tasks, a leader that is 0.2 rad ahead, and a camera whose red rises by 5 an image.
MARKED = [
    *states(6.0),
    *states(6.0, topic="/teleop/leader_joint_states", offset=0.2, late_s=0.003),
    *(image(n / 10, 5 * n) for n in range(51)),
    mark("start pick the cube", 1.0),
    mark("stop", 2.0),
    mark("start drop it", 3.0),
    mark("stop", 4.5),
]
REDS = [5 * n for n in (*range(10, 21), *range(30, 46))]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two episodes, which tests only read."""
    folder = tmp_path_factory.mktemp("dataset")
    done = exported(folder / "data", record(folder / "run.mcap", in_order(MARKED)))
    assert done == Exported(2, 27, (KEY,), "/teleop/leader_joint_states", ())
    return folder / "data"


def test_info_describes_the_dataset_as_lerobot_v3_has_it(dataset: Path) -> None:
    told = info(dataset)
    vector = {"dtype": "float32", "shape": [2], "names": ["shoulder_pan.pos", "gripper.pos"]}
    assert told["features"].pop(KEY)["shape"] == [24, 32, 3]
    index = {"shape": [1], "names": None}
    assert told["features"] == {
        "action": vector,
        "observation.state": vector,
        "timestamp": {"dtype": "float32", **index},
        **{name: {"dtype": "int64", **index} for name in ("frame_index", "episode_index", "index", "task_index")},
    }
    assert {key: value for key, value in told.items() if key != "features"} == {
        "codebase_version": "v3.0",
        "robot_type": None,
        "total_episodes": 2,
        "total_frames": 27,
        "total_tasks": 2,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": "0:2"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }


def test_frames_have_state_and_action_at_a_fixed_rate(dataset: Path) -> None:
    at_s = np.concatenate([1.0 + np.arange(11) / FPS, 3.0 + np.arange(16) / FPS])
    assert column(dataset, "observation.state")[:, 0] == pytest.approx(0.1 * at_s, abs=1e-6)
    # The leader's last message before the frame is up to one period of 20 ms old, here by the 3 ms of the network.
    assert column(dataset, "action")[:, 0] == pytest.approx(0.1 * at_s + 0.2, abs=0.0021)
    assert column(dataset, "timestamp") == pytest.approx([*np.arange(11) / FPS, *np.arange(16) / FPS])
    assert column(dataset, "index").tolist() == list(range(27))
    assert column(dataset, "frame_index").tolist() == [*range(11), *range(16)]
    for name in ("episode_index", "task_index"):
        assert column(dataset, name).tolist() == [0] * 11 + [1] * 16
    file = parquet.ParquetFile(dataset / "data/chunk-000/file-000.parquet")
    kinds = {
        "timestamp": pa.float32(),
        **dict.fromkeys(("action", "observation.state"), pa.list_(pa.float32(), 2)),
        **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), pa.int64()),
    }
    assert {name: file.schema_arrow.field(name).type for name in kinds} == kinds
    assert file.num_row_groups == 2


def test_episodes_say_where_their_frames_are(dataset: Path) -> None:
    first, second = rows(dataset, "meta/episodes/chunk-000/file-000.parquet")
    parts = ("data", f"videos/{KEY}", "meta/episodes")
    indexes = [f"{part}/{kind}_index" for part in parts for kind in ("chunk", "file")]
    places = {
        "episode_index": 1,
        "tasks": ["drop it"],
        "length": 16,
        "dataset_from_index": 11,
        "dataset_to_index": 27,
        f"videos/{KEY}/from_timestamp": 1.1,
        f"videos/{KEY}/to_timestamp": 2.7,
        **dict.fromkeys(indexes, 0),
    }
    assert {name: second[name] for name in places} == places
    assert first["dataset_to_index"] == 11
    assert second["stats/observation.state/max"] == pytest.approx([0.45, 0.5])
    assert second["stats/observation.state/count"] == [16]
    assert np.shape(second[f"stats/{KEY}/mean"]) == (3, 1, 1)


def test_tasks_are_found_by_the_index_of_pandas_and_statistics_are_of_all_frames(dataset: Path) -> None:
    table = parquet.read_table(dataset / "meta/tasks.parquet")
    assert table.to_pydict() == {"task_index": [0, 1], "task": ["pick the cube", "drop it"]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    told = json.loads((dataset / "meta/stats.json").read_text())
    states_, of_states = column(dataset, "observation.state"), told["observation.state"]
    assert of_states["mean"] == pytest.approx(states_.mean(axis=0))
    assert of_states["std"] == pytest.approx(states_.std(axis=0))
    assert of_states["q90"] == pytest.approx(np.quantile(states_, 0.9, axis=0))
    assert [told["index"][name] for name in ("min", "max", "mean", "count")] == [[0], [26], [13], [27]]
    assert told[KEY]["mean"][0][0][0] == pytest.approx(np.mean(REDS) / 255, abs=0.01)
    assert told[KEY]["count"] == [27]


def test_the_video_shows_at_each_frame_what_the_camera_saw_then(dataset: Path) -> None:
    with av.open(str(dataset / f"videos/{KEY}/chunk-000/file-000.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", FPS)
        frames = [(float(each.time), each.to_ndarray(format="rgb24")) for each in container.decode(stream)]
    assert [at_s for at_s, _ in frames] == pytest.approx(np.arange(27) / FPS, abs=1e-4)
    reds = [pixels[:, :, 0].mean() for _, pixels in frames]
    assert reds == pytest.approx(REDS, abs=4)


def test_a_recording_without_marks_is_one_episode_as_the_options_say(recorded: Record, tmp_path: Path) -> None:
    data, right = tmp_path / "data", "/right/joint_states"
    recording = recorded([*states(2.0, topic=right), *states(1.0, topic="/left/joint_states")])
    done = exported(data, recording, task="wave", state_topic=right)
    assert done == Exported(1, 20, (), "the next state", ())
    assert column(data, "action")[:-1].tolist() == column(data, "observation.state")[1:].tolist()
    assert info(data)["video_path"] is None
    assert rows(data, "meta/tasks.parquet")[0]["task"] == "wave"


def test_a_joint_that_the_first_state_lacks_is_exported(recorded: Record, tmp_path: Path) -> None:
    pan = entry("/joint_states", "sensor_msgs/JointState", {"name": [JOINTS[0]], "position": [0.0]}, 0.0)
    exported(tmp_path / "data", recorded([pan, *states(1.0, 0.02)]))
    assert info(tmp_path / "data")["features"]["action"]["names"] == ["shoulder_pan.pos", "gripper.pos"]


LEADER = "/teleop/leader_joint_states"
PAN, GRIPPER = (f"/{joint}_controller/controller_state" for joint in JOINTS)


def commanded(joint: str, at_s: float, position: float) -> Any:
    """A controller's state with the commanded position of one joint."""
    msg = {"header": stamp(at_s), "joint_names": [joint], "reference": {"positions": [position]}}
    return entry(f"/{joint}_controller/controller_state", "control_msgs/JointTrajectoryControllerState", msg, at_s)


def pan_alone(topic: str, at_s: float) -> Any:
    """A message of actions that has no gripper."""
    msg = {"header": stamp(at_s), "name": [JOINTS[0]], "position": [0.3]}
    return commanded(JOINTS[0], at_s, 0.3) if topic == PAN else entry(topic, "sensor_msgs/JointState", msg, at_s)


def test_each_episode_has_the_actions_of_who_commanded_the_arm_in_it(recorded: Record, tmp_path: Path) -> None:
    """The leader leads in the first and stops early in the second; in the third nothing is recorded but states."""
    marks = [mark(kind, at_s) for n in range(3) for kind, at_s in (("start", 3.0 * n), ("stop", 3.0 * n + 2.0))]
    led = states(3.4, topic=LEADER, offset=0.2)
    commands = [commanded(joint, n / 10, 0.7) for n in range(55) for joint in JOINTS]
    done = exported(tmp_path / "data", recorded([*states(9.0), *led, *commands, *marks]))
    assert (done.episodes, done.problems) == (3, ())
    assert done.actions == f"{LEADER} (1), {GRIPPER} and {PAN} (1), the next state (1)"
    first, second, third = (column(tmp_path / "data", "action")[n : n + 20, 0] for n in (0, 21, 42))
    assert first == pytest.approx(0.2 + np.arange(20) / 100, abs=0.0021)
    assert second == pytest.approx(0.7)
    assert third == pytest.approx(0.601 + np.arange(20) / 100, abs=0.01)


def test_an_episode_with_a_silent_leader_is_left_out_without_other_commands(recorded: Record, tmp_path: Path) -> None:
    marks = [mark(kind, at_s) for n in range(2) for kind, at_s in (("start", 3.0 * n), ("stop", 3.0 * n + 2.0))]
    done = exported(tmp_path / "data", recorded([*states(9.0), *states(4.0, topic=LEADER), *marks]))
    assert (done.episodes, done.actions) == (1, LEADER)
    assert "episode 2 (3.0 to 5.0 s) is left out: the actions on" in done.problems[0]


@pytest.mark.parametrize(
    ("topic", "options", "actions"),
    [
        (PAN, {}, f"{GRIPPER} and {PAN}"),
        (LEADER, {}, f"{LEADER} and {GRIPPER}"),
        ("/program", {"action_topic": "/program"}, f"/program and {GRIPPER}"),
    ],
)
def test_a_gripper_that_the_actions_lack_has_the_commands_of_its_controller(
    recorded: Record, tmp_path: Path, topic: str, options: dict[str, str], actions: str
) -> None:
    pan = [*states(1.0), *(pan_alone(topic, n / 10) for n in range(11))]
    if options:
        with pytest.raises(ExportError, match="--action-topic /program has no gripper"):
            exported(tmp_path / "none", recorded(pan), **options)
    else:
        assert exported(tmp_path / "some", recorded(pan)).actions == "the next state"
    gripper = [commanded(JOINTS[1], n / 10, 0.1 * n) for n in range(11)]
    assert exported(tmp_path / "data", recorded([*pan, *gripper]), **options).actions == actions
    expected = np.column_stack([np.full(11, 0.3), 0.1 * np.arange(11)])
    assert column(tmp_path / "data", "action") == pytest.approx(expected)


def status(topic: str, values: dict[str, str], hardware_id: str = "", at_s: float = 0.0) -> RecordedMessage:
    listed = [{"key": key, "value": value} for key, value in values.items()]
    msg = {"level": 0, "name": "", "message": "", "hardware_id": hardware_id, "values": listed}
    return entry(topic, "diagnostic_msgs/DiagnosticStatus", msg, at_s)


def calibrated(**ranges: str) -> RecordedMessage:
    """A state of the arm with its calibrated ranges."""
    return status("/arm/state", {f"calibrated_range_rad.{name}": ends for name, ends in ranges.items()}, "so101")


def test_units_of_lerobot_use_the_grippers_calibrated_range_or_its_limits(recorded: Record, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="--units lerobot needs the range of gripper"):
        exported(tmp_path / "data", recorded(states(1.0)), units="lerobot")
    limit = {"joint_name": "gripper", "min_position": 0.0, "max_position": 2.0}
    msg = {"joint_names": ["gripper"], "limits": [limit]}
    limits = entry("/arm/joint_limits", "moveit_msgs/KinematicSolverInfo", msg)
    ends = calibrated(shoulder_pan="none", gripper="-0.5 1.5")
    for name, known, percent in (("limits", [limits], 25.0), ("ends", [limits, ends], 50.0)):
        exported(tmp_path / name, recorded([*known, *states(1.0)]), units="lerobot")
        assert column(tmp_path / name, "observation.state")[-1] == pytest.approx([np.degrees(0.09), percent])


def test_an_export_has_the_arm_its_ranges_and_the_zero_of_its_degrees(recorded: Record, tmp_path: Path) -> None:
    recording = recorded([calibrated(shoulder_pan="-1.0 1.4", gripper="0.0 1.0"), *states(1.0)])
    exported(tmp_path / "data", recording, units="lerobot")
    # lerobot counts from the middle of the calibrated range.
    assert column(tmp_path / "data", "observation.state")[-1] == pytest.approx([np.degrees(0.09 - 0.2), 50.0])
    arm = json.loads((tmp_path / "data/meta/armbridge.json").read_text())
    assert (arm["robot"], arm["units"], len(arm["calibration"])) == ("so101", "lerobot", 12)
    pan = {"zero_rad": pytest.approx(0.2), "range_rad": [-1.0, 1.4], "limits_rad": None}
    assert arm["joints"]["shoulder_pan"] == pan


def test_an_episode_with_a_gap_is_left_out_and_said(recorded: Record, tmp_path: Path) -> None:
    marks = [mark("start", 0.0), mark("stop", 1.0), mark("start", 1.2), mark("stop", 3.0)]
    recording = recorded([*states(1.5), *states(3.0, 2.3), *marks])
    assert exported(tmp_path / "all", recording, max_gap_s=1.0).episodes == 2
    done = exported(tmp_path / "data", recording)
    left_out = "episode 2 (1.2 to 3.0 s) is left out: the states have a gap of 0.8 s, 0.3 s after it begins"
    assert (done.episodes, done.problems) == (1, (left_out,))


def with_images(message: Callable[[int], RecordedMessage]) -> list[RecordedMessage]:
    return [*states(1.0), *(message(n) for n in range(11))]


def unlike(type_name: str, **fields: Any) -> list[RecordedMessage]:
    """States, and images on /c that are none."""
    return with_images(lambda n: entry("/c", type_name, fields, n / 10))


CUT_OFF = {"height": 24, "width": 32, "encoding": "rgb8", "step": 96, "data": "AAAA"}
REFUSED: list[tuple[list[RecordedMessage], dict[str, str], str]] = [
    ([mark("start", 0.0)], {}, "has no messages of sensor_msgs/JointState on /joint_states"),
    ([state(0.0)], {}, "no episode can be exported: .* it has 0 frames at 10 a second, and needs 2"),
    # A machine whose clock was set; a frame for each tenth of a second would fill 32 GB.
    ([*states(1.0), state(4e8)], {}, "no episode can be exported: .* the states have a gap of 399999999.0 s"),
    (states(1.0), {"action_topic": "/x"}, "--action-topic must be one of /joint_states, not /x"),
    (
        [*states(1.0, topic="/left/joint_states"), *states(1.0, topic="/right/joint_states")],
        {},
        "no messages of .* on /joint_states: --state-topic must be one of /left/joint_states, /right/joint_states",
    ),
    (
        with_images(lambda n: image(n / 10, 9, width=31)),
        {},
        "image 1 of /camera/image/compressed: images must have even width and height for yuv420p, not 31x24",
    ),
    (
        with_images(lambda n: image(n / 10, 9, width=32 + 2 * (n == 5))),
        {},
        "image 6 of /camera/image/compressed: all images must have the size of the first one, 32x24, not 34x24",
    ),
    (
        unlike("sensor_msgs/CompressedImage", format="h264", data="AAAA"),
        {},
        "image 1 of /c: an image cannot be read: it is 'h264', wanted jpeg or png",
    ),
    (unlike("sensor_msgs/Image", **CUT_OFF), {}, "image 1 of /c: an image of 32x24 pixels has 3 bytes, and 96 a row"),
]


@pytest.mark.parametrize(("entries", "options", "sentence"), REFUSED)
def test_what_makes_no_dataset_is_refused_and_nothing_is_left_behind(
    entries: list[RecordedMessage], options: dict[str, str], sentence: str, recorded: Record, tmp_path: Path
) -> None:
    recording = recorded(entries)
    with pytest.raises(ExportError, match=sentence):
        exported(tmp_path / "data", recording, **options)
    assert list(tmp_path.iterdir()) == [recording]


@pytest.mark.parametrize("missing", ["pyarrow", "av"])
def test_extras_are_named(missing: str, recorded: Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = export_module.find_spec
    monkeypatch.setattr(export_module, "find_spec", lambda name: None if name == missing else find(name))
    with pytest.raises(ExportError, match=rf"{missing}: pip install 'armbridge\[datasets\]'"):
        exported(tmp_path / "data", recorded([*states(1.0), image(0.0, 9)]))


def test_cameras_are_named_after_what_is_theirs_in_the_topic() -> None:
    topics = ["/camera/image/compressed", "/left/wrist/image_raw/compressed", "/image", "/camera/compressed"]
    assert camera_keys(topics) == {
        "observation.images.camera": "/camera/compressed",
        "observation.images.camera_image_compressed": "/camera/image/compressed",
        "observation.images.image": "/image",
        "observation.images.left_wrist": "/left/wrist/image_raw/compressed",
    }


def test_the_command_reports_its_work(recorded: Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "data"
    recording = recorded([*states(2.0), mark("start", 0.0), mark("stop", 1.0), mark("stop", 1.5)])
    arguments = ["export", str(recording), "--format", "lerobot", "--output", str(output), "--fps", "10"]
    assert main(arguments) == 3
    told = capsys.readouterr()
    assert told.out == f"{output}: 1 episodes, 10 frames at 10 a second, no camera; actions: the next state\n"
    assert "* " in told.err
    assert "the stop at 1.5 s has no start" in told.err
    assert main(arguments) == 1
    assert "exists already: name another folder" in capsys.readouterr().err


def phase(phase: str, at_s: float, topic: str = "/arm/chunks/state") -> RecordedMessage:
    """A state of the policy, as the server publishes it."""
    return status(topic, {"phase": phase, "client": "policy"}, at_s=at_s)


def test_frames_in_which_a_person_has_taken_over_from_the_policy_are_marked(tmp_path: Path, recorded: Record) -> None:
    phases = [phase("idle", 0.0), phase("following", 0.5), phase("taken_over", 1.05), phase("idle", 2.05)]
    led, idle = recorded([*states(3.0), *phases]), recorded([*states(1.0), phase("idle", 0.0)])
    exported(tmp_path / "data", led, video=False)
    taken_over = column(tmp_path / "data", "intervention")
    assert np.flatnonzero(taken_over).tolist() == list(range(11, 21))
    assert info(tmp_path / "data")["features"]["intervention"] == {"dtype": "bool", "shape": [1], "names": None}
    exported(tmp_path / "idle", idle, video=False)
    assert "intervention" not in info(tmp_path / "idle")["features"]


def test_a_policy_of_another_arm_that_goes_on_ends_no_intervention(tmp_path: Path, recorded: Record) -> None:
    left, right = (f"/{arm}/arm/chunks/state" for arm in ("left", "right"))
    led = [phase("taken_over", 0.55, left), phase("following", 0.65, right), phase("idle", 1.05, left)]
    exported(tmp_path / "data", recorded([*states(2.0), *led]), video=False)
    assert np.flatnonzero(column(tmp_path / "data", "intervention")).tolist() == list(range(6, 11))


def bag(folder: Path, storage: StoragePlugin, entries: Iterable[RecordedMessage]) -> Path:
    """Write a bag with rosbags, an independent implementation of rosbag2."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        known = {}
        for each in entries:
            if each.topic not in known:
                known[each.topic] = writer.add_connection(each.topic, each.type_name, typestore=types)
            writer.write(known[each.topic], each.log_time_ns, each.octets)
    return folder


def raw_image(at_s: float, encoding: str, pixel: list[int], topic: str = "/wrist/image_raw") -> RecordedMessage:
    """A picture of one colour, whose rows are padded as drivers do."""
    row = bytes(pixel) * 32 + bytes(4)
    size = {"height": 24, "width": 32, "encoding": encoding, "step": len(row)}
    msg = {"header": stamp(at_s), **size, "data": base64.b64encode(row * 24).decode()}
    return entry(topic, "sensor_msgs/Image", msg, at_s)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize(("encoding", "pixel"), [("rgb8", [200, 40, 90]), ("bgra8", [90, 40, 200, 7])])
def test_raw_images_are_exported(tmp_path: Path, storage: StoragePlugin, encoding: str, pixel: list[int]) -> None:
    pictures = [raw_image(n / 10, encoding, pixel) for n in range(21)]
    same = [image(n / 10, 9, topic="/side/image_raw/compressed") for n in range(21)]
    twin = [raw_image(n / 10, "rgb8", [0, 0, 0], topic="/side/image_raw") for n in range(21)]
    depths = [raw_image(n / 10, "16UC1", [1, 1], topic="/depth/image_raw") for n in range(21)]
    entries = in_order([*states(2.0, topic="/robot/joint_states"), *pictures, *same, *twin, *depths])
    told: list[str] = []
    options = ExportOptions(bag(tmp_path / "run", storage, entries), tmp_path / "data", FPS)
    done = export(options, REGISTRY, told.append)
    assert (done.frames, done.problems) == (20, ())
    assert done.cameras == ("observation.images.side", "observation.images.wrist")
    assert told[0] == f"{tmp_path}/run: /depth/image_raw is left out: its images are 16UC1"
    statistics = json.loads((tmp_path / "data/meta/stats.json").read_text())["observation.images.wrist"]
    assert np.ravel(statistics["mean"]) * 255 == pytest.approx([200, 40, 90])
    assert column(tmp_path / "data", "observation.state")[:, 0] == pytest.approx(0.01 * np.arange(20), abs=1e-6)
