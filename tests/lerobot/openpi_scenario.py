"""A policy server by openpi's documented protocol, without openpi: it prints what it receives, and answers as asked.

Documented in Physical-Intelligence/openpi: ``docs/remote_inference.md`` and ``openpi_client/msgpack_numpy.py``.
"""

import json
import sys
from typing import Any

import msgpack
import numpy as np
from websockets.sync.server import ServerConnection, serve

COUNT = 60
STEP_RAD = 0.004


def array(values: np.ndarray) -> dict[bytes, Any]:
    return {b"__ndarray__": True, b"data": values.tobytes(), b"dtype": values.dtype.str, b"shape": list(values.shape)}


def described(key: str, value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    assert value[b"__ndarray__"] is True
    values = np.frombuffer(value[b"data"], np.dtype(value[b"dtype"])).reshape(value[b"shape"])
    return values.tolist() if "state" in key or "position" in key else [value[b"dtype"], *values.shape]


def chunk(state: list[float], kind: str) -> dict[bytes, Any]:
    actions = np.tile(np.array(state, dtype=np.float64), (COUNT, 1))
    actions[:, 0] += STEP_RAD * np.arange(1, COUNT + 1)
    if kind == "far":
        actions[:, 0] = 0.9
    if kind == "nan":
        actions[5, 0] = np.nan
    if kind == "narrow":
        actions = actions[:, :4]
    if kind == "objects":
        return {b"__ndarray__": True, b"data": bytes(8 * actions.size), b"dtype": "|O", b"shape": list(actions.shape)}
    if kind == "syntax":
        return {b"__ndarray__": True, b"data": b"", b"dtype": "f8,(", b"shape": [0]}
    if kind == "cut":
        return {**array(actions), b"data": actions.tobytes()[:-8]}
    return array(actions)


def handle(connection: ServerConnection, kind: str) -> None:
    connection.send(msgpack.packb({"policy": "stub"}))
    for number, data in enumerate(connection):
        observation = {key: described(key, value) for key, value in msgpack.unpackb(data).items()}
        print(json.dumps(observation), flush=True)
        if kind == "trace":
            connection.send("Traceback (most recent call last):\n  ...\nKeyError: 'observation/state'\n")
        elif kind == "dies" and number == 2:
            connection.close()
        elif kind == "no map":
            connection.send(msgpack.packb([1, 2]))
        else:
            state = observation.get("observation/state") or observation["observation/joint_position"]
            gripper = observation.get("observation/gripper_position", [])
            answer = {"actions": chunk([*state, *gripper], kind), "server_timing": {"infer_ms": 3.0}}
            connection.send(msgpack.packb(answer))


def main(port: str, kind: str) -> None:
    with serve(lambda connection: handle(connection, kind), "127.0.0.1", int(port), compression=None) as server:
        server.serve_forever()


main(*sys.argv[1:])
