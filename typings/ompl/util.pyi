"""The part of ompl.util 2.0 that is used."""

from enum import Enum

class LogLevel(Enum):
    LOG_NONE = ...

LOG_NONE: LogLevel

def setLogLevel(level: LogLevel) -> None: ...

class RNG:
    @staticmethod
    def setSeed(seed: int) -> None: ...
