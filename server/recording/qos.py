"""The quality of service of a recorded topic, as rosbag2 notes it with a channel: which topics are latched."""

from __future__ import annotations

import re
from collections.abc import Mapping

# rosbag2's key in a channel's metadata; its value is YAML, and its reader wants every policy named.
KEY = "offered_qos_profiles"

_NEVER = "{sec: 9223372036, nsec: 854775807}"
_PROFILE = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {never}
  lifespan: {never}
  liveliness: automatic
  liveliness_lease_duration: {never}
  avoid_ros_namespace_conventions: false
"""

# Releases of rosbag2 before Iron note numbers (rmw_qos_durability_policy_t).
_LATCHED = re.compile(r"\bdurability: *(transient_local|1)\b")


def channel_metadata(latched: bool) -> dict[str, str]:
    """What to note with the channel of a topic."""
    durability, depth = ("transient_local", 1) if latched else ("volatile", 10)
    return {KEY: _PROFILE.format(durability=durability, depth=depth, never=_NEVER)}


def is_latched(metadata: Mapping[str, str]) -> bool:
    """Whether a channel's metadata tell of a latched topic."""
    return _LATCHED.search(metadata.get(KEY, "")) is not None
