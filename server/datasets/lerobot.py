"""Files of a LeRobotDataset v3.0: frames in Parquet, metadata of episodes and tasks, statistics and ``info.json``.

The format is lerobot's ``LeRobotDataset`` with the codebase version v3.0 (huggingface/lerobot,
``src/lerobot/datasets``: ``dataset_metadata.py``, ``dataset_writer.py``, ``utils.py``). All episodes are in one file of
each kind; readers find them by the indices and times in ``meta/episodes``.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

import numpy as np
import pybase64
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from server.datasets.frames import EpisodeFrames
from server.datasets.samples import COLOURS

CODEC, PIXEL_FORMAT = "h264", "yuv420p"

# A key frame every other frame, as lerobot does: training reads single frames at random.
ENCODER_OPTIONS = {"g": "2", "crf": "23", "preset": "veryfast"}

# Larger ones are damage, or no camera's.
MAX_SIDE_PIXELS = 8192


class VideoError(Exception):
    """Images that make no video; the text is one sentence."""


def pixels_of(message: Mapping[str, Any]) -> NDArray[np.uint8]:
    """Return an image of sensor_msgs, raw or compressed, with shape (height, width, 3), or raise VideoError."""
    # uint8[] is base64 text in the server's messages, as in rosbridge's JSON.
    data = pybase64.b64decode(message["data"])
    if "encoding" in message:
        channels, order = COLOURS[message["encoding"]]
        height, width, step = (message[name] for name in ("height", "width", "step"))
        if not 0 < min(height, width) <= max(height, width) <= MAX_SIDE_PIXELS:
            raise VideoError(f"an image must have 1 to {MAX_SIDE_PIXELS} pixels a side, not {width}x{height}")
        if step < width * channels or len(data) < height * step:
            raise VideoError(f"an image of {width}x{height} pixels has {len(data)} bytes, and {step} a row")
        lines = np.frombuffer(data, dtype=np.uint8, count=height * step).reshape(height, step)
        return lines[:, : width * channels].reshape(height, width, channels)[:, :, list(order)]
    try:
        with Image.open(io.BytesIO(data)) as image:
            if max(image.size) > MAX_SIDE_PIXELS:
                raise VideoError(f"an image must have at most {MAX_SIDE_PIXELS} pixels a side, not {max(image.size)}")
            return np.asarray(image.convert("RGB"))
    except UnidentifiedImageError as error:
        raise VideoError(f"an image cannot be read: it is {message['format']!r}, wanted jpeg or png") from error
    except (OSError, ValueError, SyntaxError) as error:
        raise VideoError(f"an image cannot be read: {error}") from error


class VideoWriter:
    """MP4 file that is being written; ``shape`` is (height, width), zeros before the first frame."""

    def __init__(self, path: Path, fps: int) -> None:
        # Imported when it is needed: an extra of those who export videos.
        import av

        self.shape = (0, 0)
        self.frames = 0
        self._fps = fps
        self._make_frame = av.VideoFrame.from_ndarray
        self._container = av.open(str(path), "w")
        stream: Any = self._container.add_stream(CODEC, rate=fps, options=dict(ENCODER_OPTIONS))
        self._stream = stream
        self._stream.pix_fmt = PIXEL_FORMAT
        self._stream.time_base = Fraction(1, fps)

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None and self.frames:
            self._container.mux(self._stream.encode())
        self._container.close()

    def add(self, image: NDArray[np.uint8], times: int) -> None:
        """Append an image of shape (height, width, 3), or raise VideoError if its size does not fit."""
        height, width = image.shape[:2]
        if not self.frames:
            if height % 2 or width % 2:
                raise VideoError(f"images must have even width and height for {PIXEL_FORMAT}, not {width}x{height}")
            self.shape = height, width
            self._stream.width, self._stream.height = width, height
        if self.shape != (height, width):
            first = f"{self.shape[1]}x{self.shape[0]}"
            raise VideoError(f"all images must have the size of the first one, {first}, not {width}x{height}")
        for _ in range(times):
            frame = self._make_frame(image, format="rgb24")
            frame.pts = self.frames
            frame.time_base = Fraction(1, self._fps)
            self._container.mux(self._stream.encode(frame))
            self.frames += 1


# Names as in lerobot's files.
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

# Values of a feature by the statistic's name, as lists that JSON and Parquet hold.
Statistics: TypeAlias = dict[str, list[Any]]

LEVELS = 256


def statistics_of(values: NDArray[Any]) -> Statistics:
    """Return the statistics of a feature of shape (frames,) or (frames, n), over its frames."""
    columns = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    quantiles = np.quantile(columns, list(QUANTILES.values()), axis=0)
    return {
        "min": columns.min(axis=0).tolist(),
        "max": columns.max(axis=0).tolist(),
        "mean": columns.mean(axis=0).tolist(),
        "std": columns.std(axis=0).tolist(),
        "count": [len(columns)],
        **dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    }


class ImageStatistics:
    """Statistics of a camera's frames, channel by channel, from the histogram of their pixels."""

    def __init__(self) -> None:
        self.frames = 0
        self._histogram = np.zeros((3, LEVELS), dtype=np.int64)

    def add(self, image: NDArray[np.uint8], times: int = 1) -> None:
        """Add the pixels of a frame, shape (height, width, 3)."""
        self.frames += times
        for channel in range(3):
            self._histogram[channel] += times * np.bincount(image[:, :, channel].ravel(), minlength=LEVELS)

    def merge(self, other: ImageStatistics) -> None:
        self.frames += other.frames
        self._histogram += other._histogram

    def result(self) -> Statistics:
        """Return the statistics of values 0 to 1, each of shape (3, 1, 1), as lerobot has statistics of images."""
        levels = np.arange(LEVELS) / (LEVELS - 1)
        pixels = self._histogram.sum(axis=1, keepdims=True)
        shares = self._histogram / pixels
        mean = shares @ levels
        std = np.sqrt(np.maximum(shares @ levels**2 - mean**2, 0.0))
        # The least level that at least this share of the pixels does not exceed.
        reached = np.cumsum(self._histogram, axis=1) / pixels
        seen = self._histogram > 0
        result = {
            "min": levels[np.argmax(seen, axis=1)],
            "max": levels[LEVELS - 1 - np.argmax(seen[:, ::-1], axis=1)],
            "mean": mean,
            "std": std,
            **{name: levels[np.argmax(reached >= share, axis=1)] for name, share in QUANTILES.items()},
        }
        return {**{name: values.reshape(3, 1, 1).tolist() for name, values in result.items()}, "count": [self.frames]}


VERSION = "v3.0"

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
TASKS_PATH, STATS_PATH, INFO_PATH = "meta/tasks.parquet", "meta/stats.json", "meta/info.json"

STATE, ACTION = "observation.state", "action"
CAMERA_PREFIX = "observation.images."

# The limits that lerobot writes into new datasets; a reader does not hold files to them.
CHUNK_FILES, DATA_FILE_MB, VIDEO_FILE_MB = 1000, 100, 200

# Column of lerobot's rollouts in which a person corrects a policy (lerobot/rollout/strategies/dagger.py).
INTERVENTION = "intervention"

# Columns that every dataset has besides its own, with their types.
INDEX_COLUMNS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


@dataclass(frozen=True)
class CameraVideo:
    """Video of a camera, as it was written."""

    height: int
    width: int
    statistics: Sequence[ImageStatistics]


@dataclass(frozen=True)
class Dataset:
    """Contents of a dataset, its episodes in its units, its cameras by keys such as ``observation.images.camera``."""

    fps: int
    joints: Sequence[str]
    robot_type: str | None
    episodes: Sequence[EpisodeFrames]
    cameras: Mapping[str, CameraVideo]

    @property
    def frames(self) -> int:
        return sum(episode.count for episode in self.episodes)

    @property
    def flat_columns(self) -> dict[str, str]:
        """Types of the columns of one value a frame; interventions only where a policy moved the arm."""
        by_policy = any(episode.interventions is not None for episode in self.episodes)
        return INDEX_COLUMNS | ({INTERVENTION: "bool"} if by_policy else {})

    @property
    def tasks(self) -> list[str]:
        """All tasks, in the order in which they occur."""
        return list(dict.fromkeys(episode.task for episode in self.episodes))


def made_file(root: Path, path: str, key: str = "") -> Path:
    """Return the path of the only file of a kind, of a video by its camera's key; its folder is made."""
    file = root / path.format(video_key=key, chunk_index=0, file_index=0)
    file.parent.mkdir(parents=True, exist_ok=True)
    return file


def write(root: Path, dataset: Dataset) -> None:
    """Write everything but the videos, which are there already."""
    columns = [_columns(dataset, index) for index in range(len(dataset.episodes))]
    features = [{name: statistics_of(values) for name, values in each.items()} for each in columns]
    for key, camera in dataset.cameras.items():
        for statistics, images in zip(features, camera.statistics, strict=True):
            statistics[key] = images.result()
    _write_data(root, dataset, columns)
    _write_episodes(root, dataset, features)
    whole = {name: statistics_of(np.concatenate([each[name] for each in columns])) for name in columns[0]}
    for key, camera in dataset.cameras.items():
        images = ImageStatistics()
        for each in camera.statistics:
            images.merge(each)
        whole[key] = images.result()
    write_json(root, STATS_PATH, whole)
    write_json(root, INFO_PATH, info(dataset))


def info(dataset: Dataset) -> dict[str, Any]:
    """Return the contents of ``meta/info.json``."""
    names = [f"{joint}.pos" for joint in dataset.joints]
    vector = {"dtype": "float32", "shape": [len(names)], "names": names}
    features: dict[str, Any] = {ACTION: vector, STATE: vector}
    for key, camera in dataset.cameras.items():
        features[key] = {
            "dtype": "video",
            "shape": [camera.height, camera.width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": camera.height,
                "video.width": camera.width,
                "video.codec": CODEC,
                "video.pix_fmt": PIXEL_FORMAT,
                "video.is_depth_map": False,
                "video.fps": dataset.fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    features |= {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in dataset.flat_columns.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": dataset.robot_type,
        "total_episodes": len(dataset.episodes),
        "total_frames": dataset.frames,
        "total_tasks": len(dataset.tasks),
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_FILE_MB,
        "video_files_size_in_mb": VIDEO_FILE_MB,
        "fps": dataset.fps,
        "splits": {"train": f"0:{len(dataset.episodes)}"},
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if dataset.cameras else None,
        "features": features,
    }


def _columns(dataset: Dataset, index: int) -> dict[str, NDArray[Any]]:
    episode = dataset.episodes[index]
    first = sum(each.count for each in dataset.episodes[:index])
    number = np.arange(episode.count, dtype=np.int64)
    taken_over = episode.interventions
    columns: dict[str, NDArray[Any]] = {
        ACTION: episode.actions.astype(np.float32),
        STATE: episode.states.astype(np.float32),
        "timestamp": (number / dataset.fps).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(episode.count, index, dtype=np.int64),
        "index": first + number,
        "task_index": np.full(episode.count, dataset.tasks.index(episode.task), dtype=np.int64),
        INTERVENTION: np.zeros(episode.count, dtype=bool) if taken_over is None else taken_over,
    }
    return {name: columns[name] for name in (ACTION, STATE, *dataset.flat_columns)}


def _write_data(root: Path, dataset: Dataset, columns: Sequence[Mapping[str, NDArray[Any]]]) -> None:
    # Imported when it is needed: an extra of those who export datasets.
    import pyarrow as pa
    from pyarrow import parquet

    vector = pa.list_(pa.float32(), len(dataset.joints))
    types = {
        ACTION: vector,
        STATE: vector,
        **{name: getattr(pa, "bool_" if dtype == "bool" else dtype)() for name, dtype in dataset.flat_columns.items()},
    }
    schema = pa.schema(list(types.items()))
    with parquet.ParquetWriter(made_file(root, DATA_PATH), schema) as writer:
        # A row group for each episode: readers fetch one episode by it.
        for each in columns:
            arrays = [pa.array(each[name].tolist(), type=types[name]) for name in types]
            writer.write_table(pa.table(dict(zip(types, arrays, strict=True)), schema=schema))


def _write_episodes(root: Path, dataset: Dataset, statistics: Sequence[Mapping[str, Statistics]]) -> None:
    # Imported when it is needed: an extra of those who export datasets.
    import pyarrow as pa
    from pyarrow import parquet

    rows: list[dict[str, Any]] = []
    first = 0
    for index, (episode, features) in enumerate(zip(dataset.episodes, statistics, strict=True)):
        end = first + episode.count
        row: dict[str, Any] = {
            "episode_index": index,
            "tasks": [episode.task],
            "length": episode.count,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": first,
            "dataset_to_index": end,
        }
        for key in dataset.cameras:
            row[f"videos/{key}/chunk_index"] = 0
            row[f"videos/{key}/file_index"] = 0
            row[f"videos/{key}/from_timestamp"] = first / dataset.fps
            row[f"videos/{key}/to_timestamp"] = end / dataset.fps
        for feature, values in features.items():
            row |= {f"stats/{feature}/{name}": value for name, value in values.items()}
        rows.append(row | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0})
        first = end
    parquet.write_table(pa.Table.from_pylist(rows), made_file(root, EPISODES_PATH))
    tasks = dataset.tasks
    table = pa.table({"task_index": pa.array(range(len(tasks)), type=pa.int64()), "task": tasks})
    # Readers find a task's number by pandas' index, which is named here as pandas itself writes it.
    described = {"index_columns": ["task"], "column_indexes": [], "columns": _PANDAS_COLUMNS, "pandas_version": "2.2.0"}
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(described)}), made_file(root, TASKS_PATH))


def _described(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
    return {"name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy_type, "metadata": None}


_PANDAS_COLUMNS = [_described("task_index", "int64", "int64"), _described("task", "unicode", "object")]


def write_json(root: Path, path: str, contents: Mapping[str, Any]) -> None:
    made_file(root, path).write_text(json.dumps(contents, indent=4, ensure_ascii=False), encoding="utf-8")
