"""Turns the settings into zenoh's configuration, as far as it can be wrong without a network."""

from __future__ import annotations

import importlib.util
import json
from typing import TYPE_CHECKING, Any

from server.errors import ConfigurationError
from server.zenoh.exposure import open_endpoint
from server.zenoh.settings import ZenohSettings

if TYPE_CHECKING:
    import zenoh


# For so long a machine may leave a response to its call unread, while answers to others wait, before it is let go [us].
# zenoh's own is five seconds, which the end of a server had to wait, too.
UNREAD_US = 1_000_000


def check_installed(settings: ZenohSettings) -> None:
    """See that zenoh is there when it is wanted, without loading it.

    Raises:
        ConfigurationError: it is not installed.
    """
    if settings.mode != "off" and importlib.util.find_spec("zenoh") is None:
        raise ConfigurationError(
            f"zenoh.mode: {settings.mode} needs the package eclipse-zenoh; pip install 'armbridge[zenoh]' brings it"
        )


def session_config(settings: ZenohSettings) -> zenoh.Config:
    """Return zenoh's configuration.

    Raises:
        ConfigurationError: zenoh is not installed, its file cannot be read, zenoh takes a value for wrong, or anybody
            could send commands.
    """
    check_installed(settings)
    # Imported when it is needed: most servers share nothing, and few have it installed.
    import zenoh

    try:
        config = zenoh.Config.from_file(str(settings.config_file)) if settings.config_file else zenoh.Config()
    except zenoh.ZError as error:
        raise ConfigurationError(f"zenoh.config_file: {settings.config_file}: {sentence(error)}") from None
    for path, value in _values(settings, config, zenoh.Config()).items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigurationError(f"zenoh: {path} = {value!r} is refused: {sentence(error)}") from None
    _check_exposure(settings, config)
    return config


def sentence(error: Exception) -> str:
    """What zenoh says of an error, without the line of its source that says so, and what it is wrapped in."""
    text = str(error)
    return (text.partition('msg: "')[2] or text).partition(" at /")[0].partition('", location')[0].rstrip(".! ")


def _check_exposure(settings: ZenohSettings, config: zenoh.Config) -> None:
    if settings.insecure or not (settings.subscribe or settings.offer):
        return
    endpoints = json.loads(config.get_json("listen/endpoints"))
    # zenoh's own file may have endpoints for each mode.
    listening = endpoints.get(settings.mode, []) if isinstance(endpoints, dict) else endpoints
    mutual_tls = json.loads(config.get_json("transport/link/tls/enable_mtls")) is True
    exposed = open_endpoint(listening, mutual_tls=mutual_tls)
    if exposed is not None:
        raise ConfigurationError(
            f"zenoh.listen: {exposed} lets everyone who reaches it send what zenoh.subscribe and zenoh.offer take in; "
            "listen on 127.0.0.1, on tls/ with enable_mtls in zenoh.config_file, or set zenoh.insecure = true"
        )


def _values(settings: ZenohSettings, config: zenoh.Config, default: zenoh.Config) -> dict[str, Any]:
    # What keeps the last messages of a topic for those who come later orders them by their time.
    values: dict[str, Any] = {"mode": settings.mode, "timestamping/enabled": True}
    if settings.config_file is None:
        values["transport/link/tx/queue/congestion_control/block/wait_before_close"] = UNREAD_US
    if settings.connect:
        values["connect/endpoints"] = settings.connect
    # By default zenoh listens on every address of the machine.
    if settings.listen or config.get_json("listen/endpoints") == default.get_json("listen/endpoints"):
        values["listen/endpoints"] = settings.listen
    if settings.scouting_multicast or settings.config_file is None:
        values["scouting/multicast/enabled"] = settings.scouting_multicast
    return values
