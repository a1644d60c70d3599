"""``armbridge camera``: the images of a camera, published on a running server."""

from __future__ import annotations

import argparse
import asyncio

from server.commands.options import Subparsers, add_command, add_connect, add_token_file, number, read_token
from server.commands.terminal import ExitCode, Terminal

DEFAULT_TOPIC = "/camera/image/compressed"
MAX_FPS = 60
DEFAULT_FPS = 15
MIN_WIDTH, MAX_WIDTH = 16, 4096
# Above 95 JPEG files grow, and show no more (Pillow's documentation of the format).
MAX_QUALITY = 95
DEFAULT_QUALITY = 80


def add_camera_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = add_command(
        subparsers,
        "camera",
        _publish,
        "publish a camera's images on a running server",
        "Publish the images of a camera as sensor_msgs/CompressedImage on a running server, which records them"
        " like everything else (docs/recording.md). Images that a slow network cannot take are dropped. It connects"
        " again when the server comes back, and ends with Ctrl+C. Needs armbridge[camera], except for the device test.",
    )
    parser.add_argument(
        "device", metavar="DEVICE", help="number or path of a camera, a video file, or test for a test pattern"
    )
    add_connect(parser)
    parser.add_argument("--topic", default=DEFAULT_TOPIC, help=f"of the images ({DEFAULT_TOPIC})")
    parser.add_argument(
        "--fps", type=number(int, 1, MAX_FPS), default=DEFAULT_FPS, metavar="N", help=f"images a second ({DEFAULT_FPS})"
    )
    parser.add_argument(
        "--width",
        type=number(int, MIN_WIDTH, MAX_WIDTH),
        metavar="PIXELS",
        help="width to scale images to (the camera's)",
    )
    parser.add_argument(
        "--quality",
        type=number(int, 1, MAX_QUALITY),
        default=DEFAULT_QUALITY,
        metavar="N",
        help=f"of JPEG, 1 to {MAX_QUALITY} ({DEFAULT_QUALITY})",
    )
    add_token_file(parser, "access.operate_tokens")


def _publish(options: argparse.Namespace, terminal: Terminal) -> ExitCode:
    # Imported when it is needed: --help answers without the server's libraries.
    from server.datasets.camera import CameraOptions, open_source, publish_camera
    from server.publishing_client import PublishedTopic

    token = read_token(options)
    target = PublishedTopic(options.connect, options.topic, token)
    chosen = CameraOptions(options.fps, options.width, options.quality, options.device)
    source = open_source(options.device, options.width)
    count, by_signal = asyncio.run(publish_camera(target, chosen, source, terminal.say))
    terminal.tell(f"{count} images published on {options.topic}")
    if by_signal or source.finite:
        return ExitCode.DONE
    terminal.say(f"armbridge: the camera {options.device} gives no more images; is it plugged in?")
    return ExitCode.FAILED
