"""Messages of diagnostic_msgs: a status with its level, and its pairs."""

from collections.abc import Mapping
from typing import Any

# https://docs.ros.org/en/rolling/p/diagnostic_msgs/msg/DiagnosticStatus.html
LEVEL_OK, LEVEL_WARN, LEVEL_ERROR = 0, 1, 2


def diagnostic_status(
    level: int, name: str, message: str, values: Mapping[str, str], hardware_id: str = ""
) -> dict[str, Any]:
    """Write a diagnostic_msgs/DiagnosticStatus."""
    return {"level": level, "name": name, "message": message, "hardware_id": hardware_id, "values": key_values(values)}


def key_values(values: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"key": key, "value": value} for key, value in values.items()]
