"""What the server shares over zenoh, and how it gets there."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from server.zenoh.exposure import is_endpoint
from server.zenoh.keys import is_name

MAX_ENTRIES = 1000

# What others look at; nothing that moves the arm.
STATE_TOPICS = (
    "/joint_states",
    "/tf",
    "/tf_static",
    "/robot_description",
    "/diagnostics",
    "/arm/*",
    "/moveit_goal_status",
    "/moveit_goal_result",
)


class ZenohSettings(BaseModel):
    """What is shared with other machines over zenoh.

    Attributes:
        mode: off, or how the server takes part: peer with others, client of a router, or router for others.
        connect: endpoints to connect to, as in tcp/192.168.1.2:7447; the server goes on trying.
        listen: endpoints to be connected to; empty for none.
        scouting_multicast: look for others in the local network by multicast.
        config_file: zenoh's own configuration, JSON5, for all that has no setting here, such as certificates; the
            settings above override it. None for zenoh's defaults.
        domain_id: what ROS 2 machines have as ROS_DOMAIN_ID; others are neither seen nor heard.
        namespace: stands before the names of this server's topics and services at the others, as in /arm1; empty for
            none.
        publish: patterns of topics that go out, as this server names them.
        subscribe: patterns of topics that come in, as this server names them; empty for none.
        offer: patterns of services of this server that others may call; empty for none.
        call: patterns of services of others that clients of this server may call; empty for none.
        role: what others may do here, of all that comes in.
        insecure: let what subscribe and offer take in come from everyone who can reach an address of listen.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    mode: Literal["off", "peer", "client", "router"] = "off"
    connect: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    listen: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    scouting_multicast: bool = False
    config_file: Path | None = None
    # DDS has room for so many, and zenoh follows it.
    domain_id: int = Field(default=0, ge=0, le=232)
    namespace: str = ""
    publish: tuple[str, ...] = Field(default=STATE_TOPICS, max_length=MAX_ENTRIES)
    subscribe: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    offer: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    call: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    role: Literal["view", "operate", "admin"] = "operate"
    insecure: bool = False

    @field_validator("connect", "listen")
    @classmethod
    def _are_endpoints(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for endpoint in value:
            if not is_endpoint(endpoint):
                raise ValueError(f"{endpoint!r} must be protocol/address, as in tcp/127.0.0.1:7447")
        return value

    @field_validator("namespace")
    @classmethod
    def _is_a_name(cls, value: str) -> str:
        if value and not is_name(value):
            raise ValueError("must be empty or a name of ROS with a slash before each part, as in /arm1")
        return value

    @model_validator(mode="after")
    def _a_client_connects(self) -> ZenohSettings:
        if self.mode == "client" and not (self.connect or self.scouting_multicast or self.config_file):
            raise ValueError("mode client needs connect: the endpoint of its router, as in tcp/192.168.1.2:7447")
        return self
