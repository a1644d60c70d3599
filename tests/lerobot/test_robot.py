"""lerobot's own commands record, replay, train and roll out on the simulated arm, by the plugin in clients/lerobot.

lerobot needs torch, and an environment of its own: ``make test-lerobot`` makes it and runs this.
"""

import itertools
import json
import math
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from threading import Event, Thread

import pytest

from armbridge_client import Arm, connect
from armbridge_client.messages import ActionChunkAnswer, Header, JointState, KinematicSolverInfo, Time
from harness.server import FAST, FAST_ARMS, ROOT, RunningServer, free_port
from harness.waiting import TIMEOUT_S, join, running, wait_until
from tests.helpers.programs import run

BIN = ROOT / "build" / "lerobot" / "bin"
SCENARIO = Path(__file__).with_name("robot_scenario.py")
COMMAND_TIMEOUT_S = 900
LEADER = "/leader/joint_states"
ANSWERS = "/arm/chunks/answer"
EPISODES, EPISODE_S, FPS = 2, 5, 15
# A chunk of 20 actions lasts for 5 s: on a busy machine a policy computes for 2 s.
POLICY_FPS = 4
# lerobot asks a hub about each dataset unless its environment forbids it.
OFFLINE = {**os.environ, "HF_HUB_OFFLINE": "1"}

pytestmark = pytest.mark.skipif(
    not (BIN / "lerobot-record").exists(), reason="lerobot is not installed: make test-lerobot does it"
)


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer(settings=FAST) as running:
        yield running


@pytest.fixture(scope="module")
def arm(server: RunningServer) -> Iterator[Arm]:
    with connect(f"ws://127.0.0.1:{server.port}") as connected:
        yield connected


@contextmanager
def leader(port: int) -> Iterator[None]:
    """Lead by hand: positions that swing, as another program publishes them."""
    ended = Event()

    def lead() -> None:
        with connect(f"ws://127.0.0.1:{port}") as arm:
            begun_s = time.monotonic()
            while not ended.wait(0.03):
                swing = math.sin(time.monotonic() - begun_s)
                sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
                position = {"shoulder_pan": 0.3, "wrist_flex": 0.3, "wrist_roll": 0.2, "gripper": 0.4}
                still = {"shoulder_lift": 0.0, "elbow_flex": 0.0}
                names = [*position, *still]
                positions = [each * swing + (0.7 if name == "gripper" else 0.0) for name, each in position.items()]
                message = JointState(Header(Time(sec, nanosec)), names, [*positions, *still.values()])
                arm.loop.run(arm.asynchronous.connection.publish(LEADER, message))

    thread = Thread(target=lead)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        join(thread)


@contextmanager
def camera(port: int) -> Iterator[None]:
    command = [str(ROOT / ".venv" / "bin" / "armbridge"), "camera", "test", "--width", "320"]
    with running([*command, "--connect", f"ws://127.0.0.1:{port}"], stderr=subprocess.DEVNULL):
        yield


def lerobot(command: str, *options: str | Path) -> str:
    """What a command of lerobot's environment prints."""
    done = run(BIN / command, *options, timeout_s=COMMAND_TIMEOUT_S, env=OFFLINE)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stderr + done.stdout


def robot(port: int, *, with_camera: bool = True) -> list[str]:
    url = f"ws://127.0.0.1:{port}"
    camera = f'{{type: armbridge, url: "{url}", topic: /camera/image/compressed, width: 320, height: 240, fps: 15}}'
    cameras = [f"--robot.cameras={{front: {camera}}}"] if with_camera else []
    return ["--robot.type=armbridge", f"--robot.url={url}", "--robot.id=simulated", *cameras]


@pytest.fixture(scope="module")
def dataset(server: RunningServer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes that lerobot-record has made of the simulated arm with the test camera, the second by --resume."""
    root = tmp_path_factory.mktemp("lerobot") / "swing"
    teleop = ["--teleop.type=armbridge", f"--teleop.url=ws://127.0.0.1:{server.port}", f"--teleop.topic={LEADER}"]
    with camera(server.port), leader(server.port):
        for resumes in ("false", "true"):
            lerobot(
                "lerobot-record",
                *robot(server.port),
                *teleop,
                "--dataset.repo_id=local/swing",
                f"--dataset.root={root}",
                "--dataset.single_task=swing",
                "--dataset.num_episodes=1",
                f"--dataset.episode_time_s={EPISODE_S}",
                f"--dataset.fps={FPS}",
                "--dataset.push_to_hub=false",
                "--play_sounds=false",
                f"--resume={resumes}",
            )
    return root


def of_dataset(root: Path) -> list[str]:
    return ["--dataset.repo_id=local/swing", f"--dataset.root={root}"]


def test_a_dataset_of_two_episodes_holds_what_the_arm_did_in_lerobots_units(dataset: Path) -> None:
    info = json.loads((dataset / "meta" / "info.json").read_text())
    assert info["total_episodes"] == EPISODES
    assert info["features"]["observation.images.front"]["shape"] == [240, 320, 3]
    figures = json.loads(lerobot("python", SCENARIO, "dataset", dataset).splitlines()[-1])
    # The leader swings by 0.3 rad; the gripper is in percent of its range.
    assert figures["action"]["shoulder_pan.pos"] == pytest.approx(math.degrees(0.3), abs=2.0)
    assert 0.0 <= figures["lowest"]["gripper.pos"] <= figures["highest"]["gripper.pos"] <= 100.0
    # The arm follows the leader; a follower that stands still has no swing.
    assert figures["state"]["shoulder_pan.pos"] > 0.5 * figures["action"]["shoulder_pan.pos"]


def test_a_recorded_episode_is_replayed_on_the_arm(server: RunningServer, arm: Arm, dataset: Path) -> None:
    arm.move_named("rest")
    # lerobot is another client: who has moved the arm controls it.
    arm.release_control()
    lerobot(
        "lerobot-replay",
        *robot(server.port, with_camera=False),
        *of_dataset(dataset),
        "--dataset.episode=0",
        "--play_sounds=false",
    )
    assert arm.state().position_rad["shoulder_lift"] == pytest.approx(0.0, abs=0.1)


@pytest.fixture(scope="module")
def policy(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ACT policy that lerobot-train has trained for a few steps."""
    output = tmp_path_factory.mktemp("policy") / "act"
    small = ["dim_model=32", "n_heads=2", "dim_feedforward=32", "n_encoder_layers=1", "n_vae_encoder_layers=1"]
    small += [
        "chunk_size=20",
        "n_action_steps=10",
        "pretrained_backbone_weights=null",
        "device=cpu",
        "push_to_hub=false",
    ]
    lerobot(
        "lerobot-train",
        *of_dataset(dataset),
        "--dataset.video_backend=pyav",
        "--policy.type=act",
        *(f"--policy.{option}" for option in small),
        "--steps=3",
        "--save_freq=3",
        "--batch_size=2",
        "--num_workers=0",
        f"--output_dir={output}",
        "--wandb.enable=false",
    )
    return output / "checkpoints" / "last" / "pretrained_model"


def test_a_policy_trained_for_a_few_steps_is_rolled_out(server: RunningServer, policy: Path) -> None:
    with camera(server.port):
        report = lerobot(
            "lerobot-rollout",
            *robot(server.port),
            f"--policy.path={policy}",
            "--policy.device=cpu",
            "--strategy.type=base",
            "--task=swing",
            f"--fps={FPS}",
            "--duration=5",
            "--play_sounds=false",
        )
    assert "ArmStopped" not in report
    assert any("teleoperation of arm: following" in line for line in server.lines)


@contextmanager
def policy_server(port: int, folder: Path) -> Iterator[None]:
    """Serve policies by lerobot's PolicyServer."""
    command = [BIN / "python", "-m", "lerobot.async_inference.policy_server", f"--port={port}", f"--fps={POLICY_FPS}"]
    with running(command, env=OFFLINE, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL):
        yield


@pytest.mark.parametrize("served", [True, False])
def test_a_policy_of_lerobot_drives_the_arm(
    server: RunningServer, arm: Arm, policy: Path, tmp_path: Path, served: bool
) -> None:
    arm.release_control()
    port = free_port()
    remote = f"--server_address=127.0.0.1:{port}", "--policy_type=act", f"--pretrained_name_or_path={policy}"
    source = remote if served else (f"--policy={policy}",)
    options = [*robot(server.port), "--task=swing", *source, "--actions_per_chunk=20", f"--fps={POLICY_FPS}"]
    lines = tmp_path / "policy.log"
    with (
        camera(server.port),
        policy_server(port, tmp_path) if served else nullcontext(),
        lines.open("w") as out,
        running(
            [BIN / "armbridge-policy", *options], env=OFFLINE, cwd=tmp_path, stdout=out, stderr=subprocess.STDOUT
        ) as client,
    ):
        answers = arm.messages(ANSWERS, ActionChunkAnswer, length=100, timeout_s=240)
        followed = list(itertools.islice((each for each in answers if each.error_code.val == 1), 5))
        assert len({each.id for each in followed}) == 5
        # A stop by anybody ends the policy, with the reason.
        arm.stop()
        assert client.wait(TIMEOUT_S) != 0
    assert "the arm was stopped" in lines.read_text()


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("--policy={missing}", "policy: {missing} cannot be loaded"),
        ("--fps=15", "robot.cameras: must be ['front'], as of the policy, not []"),
    ],
)
def test_a_policy_that_does_not_fit_the_robot_is_refused(
    server: RunningServer, policy: Path, tmp_path: Path, option: str, sentence: str
) -> None:
    missing = tmp_path / "nothing"
    command = [BIN / "armbridge-policy", *robot(server.port, with_camera=False), f"--policy={policy}"]
    done = run(*command, option.format(missing=missing), timeout_s=COMMAND_TIMEOUT_S, env=OFFLINE, cwd=tmp_path)
    assert done.returncode != 0
    assert sentence.format(missing=missing) in done.stderr.splitlines()[-1]


@contextmanager
def scenario(port: int, *arm: str) -> Iterator[subprocess.Popen[str]]:
    command = [BIN / "python", SCENARIO, "robot", f"ws://127.0.0.1:{port}", *arm]
    with running(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=1) as process:
        yield process
        process.communicate(timeout=TIMEOUT_S)


def ask(process: subprocess.Popen[str], line: str) -> dict[str, float | str]:
    assert process.stdin is not None
    assert process.stdout is not None
    print(line, file=process.stdin, flush=True)
    answer: dict[str, float | str] = json.loads(process.stdout.readline())
    return answer


@pytest.mark.parametrize("moves_first", [True, False])
def test_after_a_stop_the_next_action_is_refused_and_nothing_moves(
    server: RunningServer, arm: Arm, moves_first: bool
) -> None:
    arm.release_control()
    with scenario(server.port) as process:
        here = float(ask(process, "observe")["shoulder_pan.pos"])
        ask(process, "act shoulder_pan.pos 30")
        if moves_first:
            wait_until(lambda: abs(float(ask(process, "act shoulder_pan.pos 30")["shoulder_pan.pos"]) - here) > 5.0)
        arm.stop()
        wait_until(lambda: "error" in ask(process, "act shoulder_pan.pos -30"))
        stopped = arm.state().position_rad
        refused = ask(process, "act shoulder_pan.pos -30")
        assert str(refused["error"]).startswith("ArmStopped: the arm no longer follows: ")
        assert arm.state().position_rad == pytest.approx(stopped, abs=0.01)


def test_one_of_several_arms_follows_by_lerobots_names() -> None:
    with (
        RunningServer("--port 0 --config examples/two_arms.toml", settings=FAST_ARMS) as two,
        scenario(two.port, "left") as process,
    ):
        wait_until(lambda: float(ask(process, "act shoulder_pan.pos 15")["shoulder_pan.pos"]) > 14.0)
        assert ask(process, "observe")["elbow_flex.pos"] == pytest.approx(0.0, abs=2.0)


def test_an_action_that_is_no_number_is_refused_by_its_name(server: RunningServer) -> None:
    with scenario(server.port) as process:
        assert ask(process, "act elbow_flex.pos nan")["error"] == (
            "ValueError: elbow_flex.pos: must be a finite number, is nan"
        )


def test_units_are_there_and_back_the_same(server: RunningServer) -> None:
    with scenario(server.port) as process:
        for use_degrees in ("true", "false"):
            assert ask(process, f"units {use_degrees}")["error_rad"] == pytest.approx(0.0, abs=1e-12)


def exported_arm(folder: Path, arm: Arm, zero_rad: float, units: str = "lerobot") -> Path:
    """A dataset's description of its arm, whose first joint has another zero than this arm's."""
    limits = next(arm.messages("/arm/joint_limits", KinematicSolverInfo)).limits
    ranges = {each.joint_name: (each.min_position, each.max_position) for each in limits}
    joints = {name: {"zero_rad": 0.0, "range_rad": ends} for name, ends in ranges.items()}
    joints["shoulder_pan"]["zero_rad"] = zero_rad
    (folder / "meta").mkdir()
    (folder / "meta/armbridge.json").write_text(json.dumps({"units": units, "joints": joints}))
    return folder


@pytest.mark.parametrize(
    ("zero_rad", "units", "sentence"),
    [
        (
            0.5,
            "lerobot",
            "range of shoulder_pan differ by 28.6 degrees from this arm's (limit 1); --robot.convert=true",
        ),
        (0.0, "rad", "is in rad: export it with --units lerobot"),
    ],
)
def test_a_dataset_of_an_arm_with_another_zero_is_refused_with_the_degrees(
    server: RunningServer, arm: Arm, tmp_path: Path, zero_rad: float, units: str, sentence: str
) -> None:
    with scenario(server.port, "", str(exported_arm(tmp_path, arm, zero_rad, units))) as process:
        assert sentence in str(ask(process, "observe")["error"])


def test_a_policy_that_was_trained_on_an_export_of_an_arm_with_another_zero_moves_nothing(
    server: RunningServer, arm: Arm, tmp_path: Path
) -> None:
    root = exported_arm(tmp_path, arm, 0.5)
    (root / "train_config.json").write_text(json.dumps({"dataset": {"root": str(root)}}))
    command = [BIN / "armbridge-policy", *robot(server.port, with_camera=False), f"--policy={root}"]
    done = run(*command, timeout_s=COMMAND_TIMEOUT_S, env=OFFLINE, cwd=tmp_path)
    assert f"{root}: zero or range of shoulder_pan differ by 28.6 degrees" in done.stderr.splitlines()[-1]
    # A policy of a server has no folder, not the present one.
    command[-1] = "--openpi.url=ws://127.0.0.1:1"
    done = run(*command, timeout_s=COMMAND_TIMEOUT_S, env=OFFLINE, cwd=root)
    assert done.returncode != 0
    assert "zero or range" not in done.stderr


def test_a_dataset_of_an_arm_with_another_zero_is_converted(server: RunningServer, arm: Arm, tmp_path: Path) -> None:
    dataset = str(exported_arm(tmp_path, arm, 0.1))
    with scenario(server.port) as plain, scenario(server.port, "", dataset, "convert") as other:
        here, there = (float(ask(each, "observe")["shoulder_pan.pos"]) for each in (plain, other))
        assert here - there == pytest.approx(math.degrees(0.1), abs=0.5)
