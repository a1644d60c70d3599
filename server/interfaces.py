"""Message types of the server: packaged ones and types of the user's packages."""

import logging
from collections.abc import Sequence
from pathlib import Path

from protocol.errors import InterfaceFilesError
from protocol.registry import Registry
from server.errors import ConfigurationError

log = logging.getLogger("armbridge.interfaces")

# Packages whose types the server itself sends and reads, with those that these are made of. Its parts are written for
# the fields that the packaged definitions have.
OWN_PACKAGES = frozenset(
    (
        "action_msgs",
        "actionlib_msgs",
        "armbridge_msgs",
        "builtin_interfaces",
        "control_msgs",
        "diagnostic_msgs",
        "file_server",
        "geometry_msgs",
        "moveit_msgs",
        "object_recognition_msgs",
        "octomap_msgs",
        "rcl_interfaces",
        "rosapi",
        "rosapi_msgs",
        "rosbridge_msgs",
        "rosgraph_msgs",
        "sensor_msgs",
        "service_msgs",
        "shape_msgs",
        "std_msgs",
        "std_srvs",
        "tf2_msgs",
        "tf2_web_republisher",
        "trajectory_msgs",
        "unique_identifier_msgs",
        "visualization_msgs",
    )
)

# Names in a line of the log; the rest are counted.
MAX_NAMES_TOLD = 10


def load_registry(folders: Sequence[Path]) -> Registry:
    """Return the types of the packaged and the user's packages, or raise ConfigurationError with every problem."""
    if not folders:
        return Registry.load()
    # Imported when it is needed: most servers have no types of the user's, and start without it.
    from protocol.interface_packages import read_packages

    try:
        interfaces = read_packages(folders, OWN_PACKAGES)
    except InterfaceFilesError as error:
        raise ConfigurationError(f"server.interfaces: {error}") from error
    packages, count = interfaces.packages, len(interfaces.ros1) + len(interfaces.ros2)
    added = count - len(interfaces.replaced)
    log.info("interfaces of %d packages read: %s; %d types added", len(packages), _told(packages), added)
    if interfaces.unread:
        unread = _told([str(path) for path in interfaces.unread])
        log.warning("interface files in folders that are not read: %s", unread)
    if interfaces.replaced:
        log.info("%d types replace armbridge's: %s", len(interfaces.replaced), _told(interfaces.replaced))
    if interfaces.kept:
        log.warning(
            "%d types of these packages differ from those that armbridge itself uses, which stay: %s",
            len(interfaces.kept),
            _told(interfaces.kept),
        )
    return interfaces.registry()


def _told(names: Sequence[str]) -> str:
    shown = ", ".join(names[:MAX_NAMES_TOLD])
    return shown if len(names) <= MAX_NAMES_TOLD else f"{shown} and {len(names) - MAX_NAMES_TOLD} more"
