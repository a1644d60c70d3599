"""The section ``zenoh`` of the settings, and zenoh's configuration made from it."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, field_validator, model_validator

from server.access.rate_limits import is_loopback
from server.config_keys import SettingsSection
from server.errors import ConfigurationError
from server.zenoh.rmw import is_name

if TYPE_CHECKING:
    import zenoh

MAX_ENTRIES = 1000

# Time for which a peer may leave responses unread before its link is closed, while responses to others wait [us].
# zenoh's default is five seconds, by which the stop of a server would be delayed too.
WAIT_BEFORE_CLOSE_US = 1_000_000

# Protocols that admit only peers with a certificate, if mutual TLS is enabled.
_WITH_CERTIFICATES = ("tls", "quic")

_ENDPOINT = re.compile(r"(?P<protocol>[a-z0-9_-]+)/(?P<host>\[[^]]+\]|[^:/?#]*)")

# Topics that show the state of the arm; none that moves it.
STATE_TOPICS = (
    "/joint_states",
    "/tf",
    "/tf_static",
    "/robot_description",
    "/robot_description_semantic",
    "/diagnostics",
    "/arm/*",
    "/moveit_goal_status",
    "/moveit_goal_result",
)


class ZenohSettings(SettingsSection):
    """Topics, services and actions to share with other machines over zenoh; see docs/zenoh.md."""

    mode: Literal["off", "peer", "client", "router"] = "off"
    """off, or the server's role in the network: peer, client of a router, or router."""
    connect: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """endpoints to connect to, as in tcp/192.168.1.2:7447; retried until they answer."""
    listen: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """endpoints to listen on; empty for none."""
    config_file: Path | None = None
    """JSON5 file of zenoh's own options, such as certificates; the settings above override it; None for zenoh's
    defaults."""
    # DDS has room for this number, and zenoh follows it.
    domain_id: int = Field(default=0, ge=0, le=232)
    """ROS_DOMAIN_ID; other domains are neither seen nor heard."""
    namespace: str = ""
    """prefix of this server's names on the network, as in /arm1."""
    publish: tuple[str, ...] = Field(default=STATE_TOPICS, max_length=MAX_ENTRIES)
    """patterns of topics to publish, as this server names them."""
    subscribe: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """patterns of topics to subscribe to, as this server names them."""
    offer: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """patterns of services and actions of this server to offer."""
    call: tuple[str, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """patterns of services and actions of other machines that clients here may call."""
    role: Literal["view", "operate", "admin"] = "operate"
    """role of other machines here."""
    insecure: bool = False
    """accept data for subscribe and offer from everybody who reaches an address of listen."""

    @field_validator("namespace")
    @classmethod
    def _is_a_name(cls, value: str) -> str:
        if value and not is_name(value):
            raise ValueError("must be empty or a name of ROS with a slash before each part, as in /arm1")
        return value

    @model_validator(mode="after")
    def _a_client_connects(self) -> ZenohSettings:
        if self.mode == "client" and not (self.connect or self.config_file):
            raise ValueError("mode client needs connect: the endpoint of its router, as in tcp/192.168.1.2:7447")
        return self


def check_installed(settings: ZenohSettings) -> None:
    """Check that zenoh is installed if it is enabled, without importing it."""
    if settings.mode != "off" and importlib.util.find_spec("zenoh") is None:
        raise ConfigurationError(
            f"zenoh.mode: {settings.mode} needs the package eclipse-zenoh; pip install 'armbridge[zenoh]' brings it"
        )


def session_config(settings: ZenohSettings) -> zenoh.Config:
    """Return zenoh's configuration, or raise ConfigurationError; it is refused where strangers could send commands."""
    check_installed(settings)
    # Optional, and few servers use it.
    import zenoh

    try:
        config = zenoh.Config.from_file(str(settings.config_file)) if settings.config_file else zenoh.Config()
    except zenoh.ZError as error:
        raise ConfigurationError(f"zenoh.config_file: {settings.config_file}: {error_text(error)}") from None
    for path, value in _values(settings, config, zenoh.Config()).items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigurationError(f"zenoh: {path} = {value!r} is refused: {error_text(error)}") from None
    _check_exposure(settings, config)
    return config


def error_text(error: Exception) -> str:
    """Return the sentence of zenoh's error, without its source line and the errors that wrap it."""
    text = str(error)
    return (text.partition('msg: "')[2] or text).partition(" at /")[0].partition('", location')[0].rstrip(".! ")


def exposed_endpoint(endpoints: Iterable[str], *, mutual_tls: bool) -> str | None:
    """Return the first endpoint that admits other machines without authentication; None if there is none."""
    for endpoint in endpoints:
        found = _ENDPOINT.match(endpoint)
        if found is None:
            return endpoint
        protocol, host = found["protocol"], found["host"].strip("[]")
        is_local = protocol.startswith("unix") or host == "localhost" or is_loopback(host)
        if not is_local and not (mutual_tls and protocol in _WITH_CERTIFICATES):
            return endpoint
    return None


def _check_exposure(settings: ZenohSettings, config: zenoh.Config) -> None:
    if settings.insecure or not (settings.subscribe or settings.offer):
        return
    endpoints = json.loads(config.get_json("listen/endpoints"))
    # zenoh's own file may list endpoints by mode.
    listening = endpoints.get(settings.mode, []) if isinstance(endpoints, dict) else endpoints
    mutual_tls = json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
    exposed = exposed_endpoint(listening, mutual_tls=mutual_tls)
    if exposed is not None:
        raise ConfigurationError(
            f"zenoh.listen: {exposed} lets everyone who reaches it send what zenoh.subscribe and zenoh.offer take in; "
            "listen on 127.0.0.1, on tls/ with enable_mtls in zenoh.config_file, or set zenoh.insecure = true"
        )


def _values(settings: ZenohSettings, config: zenoh.Config, default: zenoh.Config) -> dict[str, Any]:
    # The cache of a latched topic orders messages by their timestamps.
    values: dict[str, Any] = {"mode": settings.mode, "timestamping/enabled": True}
    if settings.config_file is None:
        values["scouting/multicast/enabled"] = False
        values["transport/link/tx/queue/congestion_control/block/wait_before_close"] = WAIT_BEFORE_CLOSE_US
    if settings.connect:
        values["connect/endpoints"] = settings.connect
    # By default zenoh listens on every address of the machine.
    if settings.listen or config.get_json("listen/endpoints") == default.get_json("listen/endpoints"):
        values["listen/endpoints"] = settings.listen
    return values
