"""Editor of datasets on this machine: ``armbridge-dataset`` lists, deletes and adds episodes by lerobot's own tools.

What lerobot does not know is kept here: the arm of an export in ``meta/armbridge.json``. A dataset is complete at each
moment: a new one gets its name when it is whole.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

# lerobot asks a hub about each dataset unless the environment forbids it; it reads this when it is imported.
os.environ.setdefault("HF_HUB_OFFLINE", "1")

from lerobot.datasets import LeRobotDataset, delete_episodes, merge_datasets

from lerobot_robot_armbridge.units import ARM_PATH

INFO_PATH = "meta/info.json"
MAX_SENTENCE = 300


class DatasetError(Exception):
    """Datasets that cannot be edited as asked; the text is one sentence."""


def open_dataset(root: Path) -> LeRobotDataset:
    """Open a dataset of a folder."""
    if not (root / INFO_PATH).is_file():
        raise DatasetError(f"{root}: is no dataset of lerobot: it has no {INFO_PATH}")
    return LeRobotDataset(f"local/{root.name}", root=root)


def list_episodes(root: Path) -> list[str]:
    """Return a line for each episode, and one for the dataset."""
    meta = open_dataset(root).meta
    lines = [
        f"{each['episode_index']}: {each['length'] / meta.fps:.1f} s, {', '.join(each['tasks'])}"
        for each in meta.episodes
    ]
    cameras = ", ".join(meta.video_keys) or "no camera"
    seconds = meta.total_frames / meta.fps
    return [*lines, f"{root}: {meta.total_episodes} episodes, {seconds:.1f} s at {meta.fps} Hz, {cameras}"]


def delete(root: Path, episodes: Sequence[int]) -> str:
    """Delete episodes; the others get the numbers from 0 on."""
    dataset = open_dataset(root)
    count = dataset.meta.total_episodes
    if beyond := sorted({each for each in episodes if not 0 <= each < count}):
        raise DatasetError(f"{root}: has the episodes 0 to {count - 1}, not {beyond[0]}")
    if len(set(episodes)) == count:
        raise DatasetError(f"{root}: a dataset must keep an episode; delete the folder instead")
    arm = root / ARM_PATH

    def make(output: Path) -> None:
        delete_episodes(dataset, sorted(set(episodes)), output, dataset.repo_id)
        if arm.is_file():
            shutil.copyfile(arm, output / ARM_PATH)

    _make_whole(root, make)
    return f"{root}: {len(set(episodes))} episodes deleted, {count - len(set(episodes))} are left"


def merge(roots: Sequence[Path], output: Path) -> str:
    """Write the episodes of several datasets of one arm as a new one."""
    if output.exists():
        raise DatasetError(f"{output} exists already: name another folder (--output)")
    return _put_together(roots, output)


def add(root: Path, others: Sequence[Path]) -> str:
    """Add the episodes of other datasets of the same arm to one."""
    return _put_together([root, *others], root)


def _put_together(roots: Sequence[Path], output: Path) -> str:
    datasets = [open_dataset(root) for root in roots]
    arms = [json.loads((root / ARM_PATH).read_text()) if (root / ARM_PATH).is_file() else {} for root in roots]
    for root, arm in zip(roots, arms, strict=True):
        # Radians mean the same position with any calibration.
        keys = ("units",) if arm.get("units") == "rad" else ("units", "robot", "joints")
        if differing := [key for key in keys if arm.get(key) != arms[0].get(key)]:
            raise DatasetError(f"{root}: {ARM_PATH} has another {' and '.join(differing)} than in {roots[0]}")

    def make(folder: Path) -> None:
        # Videos of an export and of lerobot's own recordings are encoded differently: they do not fit into one file.
        merge_datasets(datasets, f"local/{output.name}", folder, concatenate_videos=False)
        if arms[0]:
            shutil.copyfile(roots[0] / ARM_PATH, folder / ARM_PATH)

    _make_whole(output, make)
    return f"{output}: {sum(each.meta.total_episodes for each in datasets)} episodes of {len(datasets)} datasets"


def _make_whole(root: Path, make: Callable[[Path], None]) -> None:
    """Make a dataset beside its place, and put it there when it is whole."""
    former = root.with_name(f"{root.name}_old")
    if former.exists():
        raise DatasetError(f"{former}: is left from an edit that was cut off; move it away, or back to {root.name}")
    root.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=root.parent, prefix=f".{root.name}-") as folder:
        made = Path(folder) / root.name
        make(made)
        if not root.exists():
            made.rename(root)
            return
        root.rename(former)
        try:
            made.rename(root)
        except BaseException:
            former.rename(root)
            raise
    shutil.rmtree(former)


def main(arguments: Sequence[str] | None = None) -> int:
    """Carry out the command line; return its exit code."""
    parser = argparse.ArgumentParser("armbridge-dataset", description="List, delete and add episodes of datasets.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    listing = commands.add_parser("list", help="list the episodes with length and task")
    listing.add_argument("root", type=Path, metavar="FOLDER")
    listing.set_defaults(run=lambda options: "\n".join(list_episodes(options.root)))
    deleting = commands.add_parser("delete", help="delete episodes; the others are numbered from 0 on")
    deleting.add_argument("root", type=Path, metavar="FOLDER")
    deleting.add_argument("episodes", type=int, nargs="+", metavar="NUMBER")
    deleting.set_defaults(run=lambda options: delete(options.root, options.episodes))
    adding = commands.add_parser("add", help="go on with a dataset: add the episodes of others to it")
    adding.add_argument("root", type=Path, metavar="FOLDER")
    adding.add_argument("others", type=Path, nargs="+", metavar="OTHER")
    adding.set_defaults(run=lambda options: add(options.root, options.others))
    merging = commands.add_parser("merge", help="write the episodes of several datasets as a new one")
    merging.add_argument("roots", type=Path, nargs="+", metavar="FOLDER")
    merging.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="folder to make")
    merging.set_defaults(run=lambda options: merge(options.roots, options.output))
    options = parser.parse_args(arguments)
    logging.disable(logging.INFO)
    try:
        print(options.run(options))
    except (DatasetError, OSError, ValueError) as error:
        # lerobot's own errors name every feature of a dataset.
        print(f"armbridge-dataset: {str(error)[:MAX_SENTENCE]}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
