"""Files of a LeRobotDataset v3.0: frames in Parquet, metadata of episodes and tasks, statistics and ``info.json``.

The format is lerobot's ``LeRobotDataset`` with the codebase version v3.0 (huggingface/lerobot,
``src/lerobot/datasets``: ``dataset_metadata.py``, ``dataset_writer.py``, ``utils.py``). All episodes are in one file of
each kind; readers find them by the indices and times in ``meta/episodes``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from server.datasets.frames import Frames
from server.datasets.statistics import ImageStatistics, Statistics, statistics_of
from server.datasets.video import CODEC, PIXEL_FORMAT

VERSION = "v3.0"

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
TASKS_PATH, STATS_PATH, INFO_PATH = "meta/tasks.parquet", "meta/stats.json", "meta/info.json"

STATE, ACTION = "observation.state", "action"
CAMERA_PREFIX = "observation.images."

# The limits that lerobot writes into new datasets; a reader does not hold files to them.
CHUNK_FILES, DATA_FILE_MB, VIDEO_FILE_MB = 1000, 100, 200

# Columns that every dataset has besides its own, with their types.
INDEX_COLUMNS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


@dataclass(frozen=True)
class Camera:
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
    episodes: Sequence[Frames]
    cameras: Mapping[str, Camera]

    @property
    def frames(self) -> int:
        """Number of all frames."""
        return sum(episode.count for episode in self.episodes)

    @property
    def tasks(self) -> list[str]:
        """All tasks, in the order in which they occur."""
        return list(dict.fromkeys(episode.task for episode in self.episodes))


def video_file(root: Path, key: str) -> Path:
    """Return the file of a camera's video."""
    return root / VIDEO_PATH.format(video_key=key, chunk_index=0, file_index=0)


def write(root: Path, dataset: Dataset) -> None:
    """Write everything but the videos, which are there already."""
    columns = [_columns(dataset, index) for index in range(len(dataset.episodes))]
    of_episodes = [{name: statistics_of(values) for name, values in each.items()} for each in columns]
    for key, camera in dataset.cameras.items():
        for statistics, images in zip(of_episodes, camera.statistics, strict=True):
            statistics[key] = images.result()
    _write_data(root, dataset, columns)
    _write_episodes(root, dataset, of_episodes)
    _write_tasks(root, dataset.tasks)
    whole = {name: statistics_of(np.concatenate([each[name] for each in columns])) for name in columns[0]}
    for key, camera in dataset.cameras.items():
        images = ImageStatistics()
        for each in camera.statistics:
            images.merge(each)
        whole[key] = images.result()
    _write_json(root / STATS_PATH, whole)
    _write_json(root / INFO_PATH, info(dataset))


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
    features |= {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in INDEX_COLUMNS.items()}
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
    return {
        ACTION: episode.actions.astype(np.float32),
        STATE: episode.states.astype(np.float32),
        "timestamp": (number / dataset.fps).astype(np.float32),
        "frame_index": number,
        "episode_index": np.full(episode.count, index, dtype=np.int64),
        "index": first + number,
        "task_index": np.full(episode.count, dataset.tasks.index(episode.task), dtype=np.int64),
    }


def _write_data(root: Path, dataset: Dataset, columns: Sequence[Mapping[str, NDArray[Any]]]) -> None:
    # Imported when it is needed: an extra of those who export datasets.
    import pyarrow as pa
    from pyarrow import parquet

    vector = pa.list_(pa.float32(), len(dataset.joints))
    types = {
        ACTION: vector,
        STATE: vector,
        **{name: getattr(pa, dtype)() for name, dtype in INDEX_COLUMNS.items()},
    }
    schema = pa.schema(list(types.items()))
    path = root / DATA_PATH.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    with parquet.ParquetWriter(path, schema) as writer:
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
    path = root / EPISODES_PATH.format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), path)


def _write_tasks(root: Path, tasks: Sequence[str]) -> None:
    # Imported when it is needed: an extra of those who export datasets.
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table({"task_index": pa.array(range(len(tasks)), type=pa.int64()), "task": list(tasks)})
    # Readers find a task's number by pandas' index, which is named here as pandas itself writes it.
    described = {"index_columns": ["task"], "column_indexes": [], "columns": _PANDAS_COLUMNS, "pandas_version": "2.2.0"}
    path = root / TASKS_PATH
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(described)}), path)


def _described(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
    return {"name": name, "field_name": name, "pandas_type": pandas_type, "numpy_type": numpy_type, "metadata": None}


_PANDAS_COLUMNS = [_described("task_index", "int64", "int64"), _described("task", "unicode", "object")]


def _write_json(path: Path, contents: Mapping[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(contents, indent=4, ensure_ascii=False), encoding="utf-8")
