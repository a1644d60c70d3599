"""Policies of lerobot, in this process or in lerobot's PolicyServer: an observation in, a chunk of actions out."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import grpc
import numpy as np
import torch
from lerobot.async_inference.helpers import (
    RemotePolicyConfig,
    TimedAction,
    TimedObservation,
    map_robot_keys_to_lerobot_features,
    raw_observation_to_observation,
)
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.robots import Robot
from lerobot.transport import services_pb2, services_pb2_grpc
from lerobot.transport.utils import grpc_channel_options, send_bytes_in_chunks
from numpy.typing import NDArray

# A server that loads a policy of some gigabytes answers within this time [s].
LOADS_WITHIN_S = 300.0
# The first inference may compile the policy [s].
ANSWERS_WITHIN_S = 120.0


class PolicyError(RuntimeError):
    """A policy that cannot be used, or that gives no actions; the text is one sentence."""


@dataclass(frozen=True)
class Observation:
    """The arm and its cameras at one time.

    Attributes:
        stamp_s: time of the joint states, by the server's clock [s since the epoch].
        positions: by ``JOINT.pos``, in the robot's units.
        positions_rad: by the server's joints.
        images: by camera, red, green and blue of shape (height, width, 3).
    """

    stamp_s: float
    positions: Mapping[str, float]
    positions_rad: Mapping[str, float]
    images: Mapping[str, NDArray[np.uint8]]
    task: str


class Policy(Protocol):
    """Policy that gives a chunk of actions for an observation; ``radians`` if not in the robot's units."""

    radians: bool

    def actions(self, observation: Observation) -> NDArray[np.float64]:
        """Return the actions from the observation's time on, shape (n, joints); raises PolicyError."""

    def reset(self) -> None:
        """Forget what was before: the arm was moved by another hand."""

    def close(self) -> None:
        """Disconnect."""


class LocalPolicy:
    """Policy of lerobot in this process, with its own processors before and after it."""

    radians = False

    def __init__(self, path: str, device: str, robot: Robot) -> None:
        try:
            config = PreTrainedConfig.from_pretrained(path)
            config.device = device
            # PyTorch's threads wait for each other: with one for each core, every other process delays all of them.
            # An ACT policy took 7 s with two threads on two busy cores, and 1.7 s with one.
            torch.set_num_threads(max((os.cpu_count() or 1) - 1, 1))
            self._policy = get_policy_class(config.type).from_pretrained(path, config=config).to(device).eval()
        except (OSError, ValueError, RuntimeError) as error:
            raise PolicyError(f"policy: {path} cannot be loaded: {error}") from error
        self._features = map_robot_keys_to_lerobot_features(robot)
        wanted = {name.rpartition(".")[2] for name in self._policy.config.image_features}
        if wanted != set(robot.cameras):
            raise PolicyError(f"robot.cameras: must be {sorted(wanted)}, as of the policy, not {[*robot.cameras]}")
        joints = self._policy.config.output_features["action"].shape[0]
        if joints != len(robot.action_features):
            raise PolicyError(f"robot.joints: must be {joints}, as of the policy, not {len(robot.action_features)}")
        on_device = {"device_processor": {"device": device}}
        self._before, self._after = make_pre_post_processors(
            self._policy.config,
            pretrained_path=path,
            preprocessor_overrides=on_device,
            postprocessor_overrides=on_device,
        )

    def actions(self, observation: Observation) -> NDArray[np.float64]:
        """Return the policy's chunk."""
        raw = _raw(observation)
        prepared = self._before(raw_observation_to_observation(raw, self._features, self._policy.config.image_features))
        with torch.inference_mode():
            chunk = self._policy.predict_action_chunk(prepared)
        # The processors are for one action of each of a batch.
        rows = [self._after(chunk[:, index, :]) for index in range(chunk.shape[1])]
        actions: NDArray[np.float64] = torch.cat(rows).cpu().numpy().astype(np.float64)
        return actions

    def reset(self) -> None:
        """Empty the policy's queues."""
        self._policy.reset()
        self._before.reset()
        self._after.reset()

    def close(self) -> None:
        """Do nothing."""


class ServedPolicy:
    """Policy in lerobot's PolicyServer, by pickled objects in gRPC (lerobot/transport/services.proto)."""

    radians = False

    def __init__(self, address: str, policy_type: str, path: str, device: str, robot: Robot, count: int) -> None:
        self._address = address
        self._channel = grpc.insecure_channel(address, grpc_channel_options())
        self._stub = services_pb2_grpc.AsyncInferenceStub(self._channel)
        features = map_robot_keys_to_lerobot_features(robot)
        config = RemotePolicyConfig(policy_type, path, features, count, device)
        try:
            self._stub.Ready(services_pb2.Empty(), timeout=ANSWERS_WITHIN_S, wait_for_ready=True)
            setup = services_pb2.PolicySetup(data=pickle.dumps(config))
            self._stub.SendPolicyInstructions(setup, timeout=LOADS_WITHIN_S)
        except grpc.RpcError as error:
            self.close()
            raise self._failed(error) from error
        self._steps = 0

    def actions(self, observation: Observation) -> NDArray[np.float64]:
        """Return the server's chunk for the observation."""
        self._steps += 1
        # The server leaves out observations that are similar to the last one, unless they must go.
        timed = TimedObservation(observation.stamp_s, self._steps, _raw(observation), must_go=True)
        until_s = time.monotonic() + ANSWERS_WITHIN_S
        try:
            sent = send_bytes_in_chunks(pickle.dumps(timed), services_pb2.Observation, silent=True)
            self._stub.SendObservations(sent, timeout=ANSWERS_WITHIN_S)
            while time.monotonic() < until_s:
                answer = self._stub.GetActions(services_pb2.Empty(), timeout=ANSWERS_WITHIN_S)
                # The server answers with nothing where its policy fails: its log has the reason.
                if answer.data:
                    found: list[TimedAction] = pickle.loads(answer.data)  # noqa: S301 - lerobot's protocol
                    return np.array([each.get_action().numpy() for each in found], dtype=np.float64)
        except grpc.RpcError as error:
            raise self._failed(error) from error
        raise PolicyError(f"server_address: {self._address} gave no actions within {ANSWERS_WITHIN_S:g} s: see its log")

    def reset(self) -> None:
        """Do nothing: the server keeps nothing of earlier observations."""

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()

    def _failed(self, error: grpc.RpcError) -> PolicyError:
        return PolicyError(f"server_address: {self._address}: {error.code().name}: {error.details()}")


def _raw(observation: Observation) -> dict[str, Any]:
    return {**observation.positions, **observation.images, "task": observation.task}
