"""Levels and pairs of diagnostic_msgs/DiagnosticStatus messages."""

# https://docs.ros.org/en/rolling/p/diagnostic_msgs/msg/DiagnosticStatus.html
LEVEL_OK, LEVEL_WARN, LEVEL_ERROR = 0, 1, 2


def key_values(values: dict[str, str]) -> list[dict[str, str]]:
    return [{"key": key, "value": value} for key, value in values.items()]
