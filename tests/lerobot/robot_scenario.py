"""The plugin in lerobot's environment: datasets that are read or edited, or a robot that a test commands by lines."""

import contextlib
import io
import json
import sys
from pathlib import Path

import numpy as np

from lerobot_robot_armbridge import Armbridge, ArmbridgeConfig
from lerobot_robot_armbridge.units import units_of


def dataset(root: str) -> None:
    """Print the half swings of action and state, and the ends of the state, by joint."""
    from lerobot.datasets import LeRobotDataset

    frames = LeRobotDataset("local/swing", root=root).hf_dataset
    joints = json.loads((Path(root) / "meta" / "info.json").read_text())["features"]["action"]["names"]
    action, state = (np.array([np.asarray(row) for row in frames[key]]) for key in ("action", "observation.state"))

    def by_joint(values: np.ndarray) -> dict[str, float]:
        return dict(zip(joints, values.tolist(), strict=True))

    print(
        json.dumps(
            {
                "action": by_joint(np.ptp(action, axis=0) / 2),
                "state": by_joint(np.ptp(state, axis=0) / 2),
                "lowest": by_joint(state.min(axis=0)),
                "highest": by_joint(state.max(axis=0)),
            }
        )
    )


def opened(root: str) -> None:
    """Open an exported dataset, and print how long it is and one frame of it."""
    from lerobot.datasets import LeRobotDataset

    dataset = LeRobotDataset("local/test", root=root, video_backend="pyav")
    frame = dataset[11]
    image = next(value for name, value in frame.items() if name.startswith("observation.images."))
    figures = {"episodes": dataset.num_episodes, "frames": dataset.num_frames, "task": frame["task"]}
    print(json.dumps({**figures, "image": list(image.shape)}))


def resume(root: str) -> None:
    """Add an episode to a dataset as lerobot-record --resume does."""
    from lerobot.datasets import LeRobotDataset
    from lerobot.utils.constants import DEFAULT_FEATURES

    dataset = LeRobotDataset.resume("local/test", root=root)
    kinds = {name: each for name, each in dataset.features.items() if name not in DEFAULT_FEATURES}
    still = {name: np.zeros(each["shape"], each["dtype"].replace("video", "uint8")) for name, each in kinds.items()}
    for _ in range(5):
        dataset.add_frame({**still, "task": "drop it"})
    dataset.save_episode()
    dataset.finalize()


def edit(commands: str) -> None:
    """Carry out command lines of armbridge-dataset; print exit code, output and last line of errors of each."""
    from lerobot_robot_armbridge.dataset import main

    for arguments in json.loads(commands):
        if arguments[0] in ("open", "resume"):
            {"open": opened, "resume": resume}[arguments[0]](arguments[1])
            continue
        out, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            code = main(arguments)
        print(json.dumps([code, out.getvalue().splitlines(), errors.getvalue().splitlines()[-1:]]))


def robot(url: str, name: str = "", dataset: str = "", convert: str = "") -> None:
    """Carry out each line of the input, and print its result."""
    folder = Path(dataset) if dataset else None
    arm = Armbridge(ArmbridgeConfig(url=url, id="scenario", arm=name, dataset=folder, convert=bool(convert)))
    try:
        arm.connect()
    except ValueError as error:
        sys.stdin.readline()
        print(json.dumps({"error": f"{type(error).__name__}: {error}"}), flush=True)
        return
    target = arm.get_observation()
    for line in sys.stdin:
        word, *rest = line.split()
        try:
            if word == "act":
                target = {**target, rest[0]: float(rest[1])}
                result = arm.send_action(target)
            elif word == "units":
                limits = {"shoulder_pan": (-1.9, 1.7), "gripper": (-0.2, 1.7)}
                values = {"calibrated_range_rad.shoulder_pan": "-2.0 1.8", "mode": "holding"}
                units = units_of(limits, values, use_degrees=rest[0] == "true")
                there = {joint: units.to_rad(joint, units.from_rad(joint, 0.3)) for joint in limits}
                result = {"error_rad": max(abs(each - 0.3) for each in there.values())}
            else:
                result = arm.get_observation()
        except Exception as error:
            result = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(result), flush=True)
    arm.disconnect()


{"dataset": dataset, "edit": edit, "robot": robot}[sys.argv[1]](*sys.argv[2:])
