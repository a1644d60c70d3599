"""Settings of the gateway: its address, and what clients may cost together."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from protocol.limits import MAX_SERVER_QUEUED_BYTES, Limits
from robot.logs import LogFormat
from server.config_keys import SettingsSection


class ServerSettings(SettingsSection):
    """Address and limits of the server."""

    host: str = "127.0.0.1"
    """address to listen on."""
    port: int = Field(default=9090, ge=0, le=65535)
    """TCP port; 0 takes a free one."""
    ros_version: int = Field(default=2, ge=1, le=2)
    """spelling of messages for clients whose URL has no ``?ros=``: ROS 1 has seq, secs and nsecs."""
    tcp_port: int | None = Field(default=None, ge=0, le=65535)
    """port of rosbridge over raw TCP (docs/protocol.md); 0 takes a free one, None for no such port."""
    # ROSIntegration's default, and the rosbridge_tcp that such clients were written for.
    tcp_ros_version: int = Field(default=1, ge=1, le=2)
    """spelling of messages for the clients of tcp_port."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """least level of the log."""
    log_format: LogFormat = "plain"
    """plain: lines for people; json: a JSON object a line, for programs (docs/operations.md)."""
    relay_unknown_types: bool = False
    """relay topics and services of unknown types, unchecked."""
    interfaces: list[Path] = Field(default_factory=list)
    """ROS packages, or folders of packages, with your own types (docs/protocol.md)."""
    tls_certificate: Path | None = None
    """PEM file of the certificate and its chain, for wss and https (docs/security.md)."""
    tls_key: Path | None = None
    """PEM file of its key, without a passphrase; only together with tls_certificate."""
    max_clients: int = Field(default=1000, ge=1, le=100_000)
    """connections at a time, including the connections of a page that loads."""
    # Behind a container's proxy all clients have one address.
    max_clients_per_address: int = Field(default=800, ge=1, le=100_000)
    """connections at a time from one address."""
    # A page that loads is thirty connections, and a classroom may come from one address.
    connections_per_s: float = Field(default=100.0, ge=1.0, le=10_000.0)
    """new connections from one address, on average; ten times this number may come at once [1/s]."""
    ping_interval_s: float = Field(default=20.0, ge=1.0, le=3600.0)
    """time between two pings to each client [s]."""
    ping_timeout_s: float = Field(default=20.0, ge=1.0, le=3600.0)
    """a client that sends no pong within this time is disconnected [s]."""
    # Some clients open a new socket between advertise and publish.
    unregister_timeout_s: float = Field(default=10.0, ge=0.0, le=3600.0)
    """time for which an unused topic keeps its type and its latched message [s]."""
    max_queued_bytes: int = Field(default=MAX_SERVER_QUEUED_BYTES, ge=65_536, le=1_000_000_000_000)
    """all data that waits for clients; beyond, the slowest clients lose messages of topics [bytes]."""
    classroom: dict[str, int] = Field(default_factory=dict, max_length=200)
    """names and ports of a classroom's servers, which administrators see on the page; armbridge classroom sets it."""
    limits: Limits = Limits()
    """limits of one client."""

    @model_validator(mode="after")
    def _key_and_certificate_come_in_pairs(self) -> ServerSettings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise ValueError(f"tls_certificate and tls_key must be given together; {missing} is missing")
        return self
