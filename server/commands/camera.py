"""``armbridge camera``: the images of a camera, published on a running server."""

from __future__ import annotations

import argparse
import asyncio
import os
from collections.abc import Callable
from pathlib import Path

from server.commands.options import Subparsers, websocket_url
from server.commands.terminal import EXIT_CODES, ExitCode, Terminal
from server.commands.verify import DEFAULT_URL, TOKEN_VARIABLE
from server.errors import ServerError

DEFAULT_TOPIC = "/camera/image/compressed"
MAX_FPS = 60
DEFAULT_FPS = 15
MIN_WIDTH, MAX_WIDTH = 16, 4096
# Above 95 JPEG files grow, and show no more (Pillow's documentation of the format).
MAX_QUALITY = 95
DEFAULT_QUALITY = 80


def add_camera_parser(subparsers: Subparsers) -> None:
    """Describe the command."""
    parser = subparsers.add_parser(
        "camera",
        help="publish a camera's images on a running server",
        description="Publish the images of a camera as sensor_msgs/CompressedImage on a running server, which records"
        " them like everything else (docs/datasets.md). Images that a slow network cannot take are dropped. It connects"
        " again when the server comes back, and ends with Ctrl+C. Needs armbridge[camera], but for the device test.",
        epilog=EXIT_CODES,
    )
    parser.add_argument(
        "device", metavar="DEVICE", help="number or path of a camera, a video file, or test for a test pattern"
    )
    parser.add_argument(
        "--connect", type=websocket_url, default=DEFAULT_URL, metavar="URL", help=f"of the server ({DEFAULT_URL})"
    )
    parser.add_argument("--topic", default=DEFAULT_TOPIC, help=f"of the images ({DEFAULT_TOPIC})")
    parser.add_argument(
        "--fps", type=_whole(1, MAX_FPS), default=DEFAULT_FPS, metavar="N", help=f"images a second ({DEFAULT_FPS})"
    )
    parser.add_argument(
        "--width", type=_whole(MIN_WIDTH, MAX_WIDTH), metavar="PIXELS", help="width to scale images to (the camera's)"
    )
    parser.add_argument(
        "--quality",
        type=_whole(1, MAX_QUALITY),
        default=DEFAULT_QUALITY,
        metavar="N",
        help=f"of JPEG, 1 to {MAX_QUALITY} ({DEFAULT_QUALITY})",
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help=f"file with one of access.operate_tokens and nothing else; else it comes from {TOKEN_VARIABLE}",
    )
    parser.set_defaults(run=run_camera)


def _whole(least: int, greatest: int) -> Callable[[str], int]:
    """Return a reader of an option's whole number, within bounds."""

    def read(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= greatest:
            raise argparse.ArgumentTypeError(f"must be a whole number from {least} to {greatest}, not {text!r}")
        return int(text)

    return read


def run_camera(options: argparse.Namespace) -> int:
    """Carry out the command."""
    # Imported when it is needed: --help answers without the server's libraries.
    from server.datasets.camera import open_source
    from server.datasets.camera_client import CameraOptions, publish_camera

    terminal = Terminal()
    token = os.environ.get(TOKEN_VARIABLE)
    if options.token_file is not None:
        try:
            token = options.token_file.read_text().strip()
        except (OSError, ValueError) as error:
            terminal.say(f"armbridge: --token-file: {options.token_file} cannot be read: {error}")
            return ExitCode.USAGE
    chosen = CameraOptions(
        options.connect, options.topic, token, options.fps, options.width, options.quality, options.device
    )
    try:
        source = open_source(options.device, options.width)
    except ServerError as error:
        terminal.say(f"armbridge: {error}")
        return ExitCode.FAILED
    count, by_signal = asyncio.run(publish_camera(chosen, source, terminal.say))
    terminal.tell(f"{count} images published on {options.topic}")
    if by_signal or source.finite:
        return ExitCode.DONE
    terminal.say(f"armbridge: the camera {options.device} gives no more images; is it plugged in?")
    return ExitCode.FAILED
