"""Policies of openpi's server: one WebSocket, messages of msgpack with numpy arrays.

The protocol is openpi's (Physical-Intelligence/openpi: ``docs/remote_inference.md``, ``websocket_policy_server.py`` and
``msgpack_numpy.py``). The server first sends its metadata. It then answers each observation with a map that has
``actions``, or with a text, the trace of its failure.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import msgpack
import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from lerobot_robot_armbridge.policies import ANSWERS_WITHIN_S, Observation, PolicyError

OPENS_WITHIN_S = 10.0
# A chunk of 500 actions of 32 joints has 128 KB.
MAX_MESSAGE_BYTES = 16 * 1024 * 1024
# Of booleans, integers and floats; an array of objects would be read from addresses that the server chooses.
DTYPE_KINDS = "biuf"


@dataclass
class OpenPiOptions:
    """The server, and the observation that its policy was trained with.

    Attributes:
        url: ``ws://HOST:8000``; empty for another kind of policy.
        api_key_file: file with the key, for a server that requires one.
        state_keys: key -> joints of its vector; none for ``observation/state`` with all joints.
        image_keys: camera -> key; none for ``observation/CAMERA``.
        image_size: images are fitted into a square of this size, with black borders [pixels]; 0 for as they are.
        actions_key: key of the answer's actions, of shape (n, joints).
        radians: joints in radians; else in the robot's units.
    """

    url: str = ""
    api_key_file: Path | None = None
    state_keys: dict[str, list[str]] = field(default_factory=dict)
    image_keys: dict[str, str] = field(default_factory=dict)
    image_size: int = 224
    prompt_key: str = "prompt"
    actions_key: str = "actions"
    radians: bool = False


class OpenPiPolicy:
    """Policy in openpi's server.

    Args:
        server_names: lerobot's joints -> the server's, in the order of the actions.
    """

    def __init__(self, options: OpenPiOptions, server_names: dict[str, str]) -> None:
        self.radians = options.radians
        self._options, self._names = options, server_names
        self._open = contextlib.ExitStack()
        self._state_keys = options.state_keys or {"observation/state": list(server_names)}
        for key, joints in self._state_keys.items():
            if unknown := sorted(set(joints) - set(server_names)):
                raise PolicyError(f"openpi.state_keys: {key} has {unknown[0]}, not one of {sorted(server_names)}")
        key_file = options.api_key_file
        headers = {} if key_file is None else {"Authorization": f"Api-Key {key_file.read_text().strip()}"}
        try:
            opened = connect(
                options.url,
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
                open_timeout=OPENS_WITHIN_S,
                additional_headers=headers,
                # The server computes in its event loop, so that it answers no ping meanwhile.
                ping_interval=None,
            )
            self._connection = self._open.enter_context(opened)
        except (OSError, ValueError, WebSocketException) as error:
            raise PolicyError(f"openpi.url: no policy server answers at {options.url}: {error}") from error
        self.metadata = self._receive()

    def actions(self, observation: Observation) -> NDArray[np.float64]:
        """Return the server's chunk for the observation."""
        message: dict[str, Any] = {
            key: np.array([self._value(observation, joint) for joint in joints], dtype=np.float32)
            for key, joints in self._state_keys.items()
        }
        for camera, image in observation.images.items():
            key = self._options.image_keys.get(camera, f"observation/{camera}")
            message[key] = fitted(image, self._options.image_size)
        message[self._options.prompt_key] = observation.task
        try:
            self._connection.send(pack(message))
        except (OSError, WebSocketException) as error:
            raise self._failed(error) from error
        answer, key = self._receive(), self._options.actions_key
        if key not in answer:
            raise PolicyError(f"openpi.actions_key: the answer has no {key!r}, but {sorted(map(str, answer))}")
        actions = np.asarray(answer[key])
        if actions.ndim != 2 or not len(actions) or actions.shape[1] != len(self._names):
            wanted = f"(n, {len(self._names)}), for {', '.join(self._names)}"
            raise PolicyError(f"{key}: must have the shape {wanted}, not {actions.shape}")
        if actions.dtype.kind not in DTYPE_KINDS or not np.isfinite(actions).all():
            raise PolicyError(f"{key}: must be finite numbers")
        return actions.astype(np.float64)

    def reset(self) -> None:
        """Do nothing: the server keeps nothing of earlier observations."""

    def close(self) -> None:
        """Close the connection."""
        self._open.close()

    def _value(self, observation: Observation, joint: str) -> float:
        if self.radians:
            return observation.positions_rad[self._names[joint]]
        return observation.positions[f"{joint}.pos"]

    def _receive(self) -> dict[str, Any]:
        try:
            data = self._connection.recv(timeout=ANSWERS_WITHIN_S)
        except (OSError, WebSocketException) as error:
            raise self._failed(error) from error
        if isinstance(data, str):
            raise PolicyError(f"the policy failed on its server: {data.strip().rpartition(chr(10))[2]}")
        try:
            message = unpack(data)
        # numpy reads the type of an array as Python's text.
        except (ValueError, TypeError, KeyError, SyntaxError, msgpack.UnpackException) as error:
            raise PolicyError(f"openpi.url: the answer of {self._options.url} cannot be read: {error}") from error
        if not isinstance(message, dict):
            raise PolicyError(f"openpi.url: {self._options.url} must answer with a map, not {type(message).__name__}")
        return message

    def _failed(self, error: Exception) -> PolicyError:
        reason = str(error) or f"nothing came within {ANSWERS_WITHIN_S:g} s"
        return PolicyError(f"openpi.url: {self._options.url}: {reason}")


def pack(message: dict[str, Any]) -> bytes:
    """Return a message as msgpack with numpy arrays."""

    def encode(value: object) -> dict[bytes, Any]:
        if not isinstance(value, np.ndarray):
            raise TypeError(f"an observation cannot have a {type(value).__name__}")
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}

    packed: bytes = msgpack.packb(message, default=encode)
    return packed


def unpack(data: bytes) -> Any:
    """Read a message; raises ValueError, TypeError, KeyError or a msgpack exception for another one."""

    def decode(value: dict[Any, Any]) -> Any:
        if b"__ndarray__" not in value and b"__npgeneric__" not in value:
            return value
        dtype = np.dtype(value[b"dtype"])
        if dtype.kind not in DTYPE_KINDS:
            raise ValueError(f"an array has the type {dtype.str!r}, which is no number")
        if b"__npgeneric__" in value:
            return dtype.type(value[b"data"])
        return np.frombuffer(value[b"data"], dtype).reshape(value[b"shape"])

    return msgpack.unpackb(data, object_hook=decode)


def fitted(image: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Return an image in a square of ``size`` pixels with black borders, shape (size, size, 3); 0 leaves it."""
    if not size:
        return image
    height, width = image.shape[:2]
    scale = size / max(height, width)
    inside = max(1, round(width * scale)), max(1, round(height * scale))
    square = np.zeros((size, size, 3), dtype=np.uint8)
    left, top = (size - inside[0]) // 2, (size - inside[1]) // 2
    square[top : top + inside[1], left : left + inside[0]] = cv2.resize(image, inside, interpolation=cv2.INTER_AREA)
    return square
