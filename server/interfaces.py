"""Message types of the server: packaged ones and types of the user's packages."""

import logging
from collections.abc import Sequence
from pathlib import Path

from protocol.errors import InterfaceFilesError
from protocol.registry import Registry
from server.errors import ConfigurationError

log = logging.getLogger("armbridge.interfaces")

# Names in a line of the log; the rest are counted.
MAX_NAMES_SHOWN = 10


def load_registry(folders: Sequence[Path]) -> Registry:
    """Return the types of the packaged and the user's packages, or raise ConfigurationError with every problem."""
    if not folders:
        return Registry.load()
    # Imported when it is needed: most servers have no types of the user's, and start without it.
    from protocol.interface_packages import read_packages

    try:
        interfaces = read_packages(folders)
    except InterfaceFilesError as error:
        raise ConfigurationError(f"server.interfaces: {error}") from error
    packages, count = interfaces.packages, len(interfaces.ros1) + len(interfaces.ros2)
    log.info("interfaces of %d packages read: %s; %d types added", len(packages), _first(packages), count)
    if interfaces.unread:
        unread = _first([str(path) for path in interfaces.unread])
        log.warning("interface files in folders that are not read: %s", unread)
    if interfaces.known:
        log.info(
            "%d types of these packages stay as armbridge has them: %s",
            len(interfaces.known),
            _first(interfaces.known),
        )
    return interfaces.registry()


def _first(names: Sequence[str]) -> str:
    shown = ", ".join(names[:MAX_NAMES_SHOWN])
    return shown if len(names) <= MAX_NAMES_SHOWN else f"{shown} and {len(names) - MAX_NAMES_SHOWN} more"
