"""Commands that publish on a running server: ``armbridge camera``, and ``leader`` for an arm that another follows."""

import argparse
import asyncio
from pathlib import Path
from typing import Any

from robot import logs
from server.commands.options import (
    SERIAL_HELP,
    WITH_TOKEN,
    Subparsers,
    add_calibration,
    add_command,
    add_connect,
    add_number,
    add_robot,
    token_from_environment,
)
from server.commands.terminal import ExitCode, Terminal
from server.errors import ConfigurationError

CAMERA_TOPIC = "/camera/image/compressed"
MAX_FPS = 60
DEFAULT_FPS = 15
MIN_WIDTH, MAX_WIDTH = 16, 4096
# Above 95 JPEG files grow, and show no more (Pillow's documentation of the format).
MAX_QUALITY = 95
DEFAULT_QUALITY = 80


def add_camera_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "camera",
        _camera,
        "publish a camera's images on a running server",
        "Publish the images of a camera as sensor_msgs/CompressedImage on a running server, which records them"
        " like everything else (docs/policies.md). Images that a slow network cannot take are dropped. It connects"
        " again when the server comes back, and ends with Ctrl+C. Needs armbridge[camera], except for the device test."
        + WITH_TOKEN,
    )
    parser.add_argument(
        "device", metavar="DEVICE", help="number or path of a camera, a video file, or test for a test pattern"
    )
    add_connect(parser)
    parser.add_argument("--topic", default=CAMERA_TOPIC, help=f"of the images ({CAMERA_TOPIC})")
    add_number(parser, "--fps", "N", (1, MAX_FPS), DEFAULT_FPS, f"images a second ({DEFAULT_FPS})")
    add_number(parser, "--width", "PIXELS", (MIN_WIDTH, MAX_WIDTH), None, "width to scale images to (the camera's)")
    text = f"of JPEG, 1 to {MAX_QUALITY} ({DEFAULT_QUALITY})"
    add_number(parser, "--quality", "N", (1, MAX_QUALITY), DEFAULT_QUALITY, text)


def _camera(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.datasets.camera import CameraClient, CameraOptions, open_source
    from server.lifecycle import run_until_signal
    from server.rosbridge_clients import PublishedTopic

    target = PublishedTopic(options.connect, options.topic, token_from_environment())
    source = open_source(options.device, options.width)
    chosen = CameraOptions(options.fps, options.width, options.quality, options.device)
    client = CameraClient(target, chosen, source, terminal.err)
    by_signal = asyncio.run(run_until_signal(client.run()))
    terminal.out(f"{client.published} images published on {options.topic}")
    if by_signal or client.finite:
        return ExitCode.DONE
    terminal.err(f"armbridge: the camera {options.device} gives no more images; is it plugged in?")
    return ExitCode.FAILED


LEADER_TOPIC = "/leader/joint_states"
DEFAULT_RATE_HZ, RATES_HZ = 100, (10, 100)


def add_leader_parser(subparsers: Subparsers) -> None:
    parser = add_command(
        subparsers,
        "leader",
        _leader,
        "stream a relaxed arm to a server, whose arm follows it",
        "Read an arm that is moved by hand, and publish its joints on a running server, whose arm follows "
        "them after /teleop/start with this topic as its leader (docs/teleoperation.md). The arm never gets torque. It "
        "connects again when the server comes back, and ends with Ctrl+C. Without --serial the arm is emulated."
        + WITH_TOKEN,
    )
    add_connect(parser)
    parser.add_argument("--serial", metavar="PORT", help=f"{SERIAL_HELP} (an emulated arm)")
    add_robot(parser, None)
    add_calibration(parser)
    parser.add_argument("--topic", default=LEADER_TOPIC, help=f"of the joints ({LEADER_TOPIC})")
    add_number(parser, "--rate", "HZ", RATES_HZ, DEFAULT_RATE_HZ, f"samples a second ({DEFAULT_RATE_HZ})")
    parser.add_argument(
        "--emulator-control", type=Path, metavar="PATH", help="Unix socket that takes commands to the emulated servos"
    )


def _leader(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    from server.config_loader import load
    from server.rosbridge_clients import PublishedTopic
    from server.teleop.leader_client import publish_leader

    token = token_from_environment()
    given: dict[str, Any] = {
        "serial": options.serial,
        "robot": options.robot,
        "calibration": options.calibration,
        "joint_state_rate_hz": float(options.rate),
        "start_enabled": False,
    }
    emulator = {} if options.emulator_control is None else {"control": options.emulator_control}
    logs.configure("WARNING", "plain")
    if options.serial is not None and options.calibration is None:
        raise ConfigurationError("--calibration: without one nobody knows where the joints of the leader are")
    settings = load(
        None, {"arm": {key: value for key, value in given.items() if value is not None}, "emulator": emulator}
    )
    target = PublishedTopic(options.connect, options.topic, token)
    by_signal = asyncio.run(publish_leader(target, settings, terminal.err))
    return ExitCode.DONE if by_signal else ExitCode.FAILED
