"""Signals that change a running server: SIGHUP, and SIGUSR1 for debug lines in the log."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import Callable

from robot import logs
from robot.logs import OUR_LOGGER, LoggerLevel

log = logging.getLogger("armbridge.monitoring")

STDIN = 0


def on_hangup(
    reload: Callable[[], None], stop: Callable[[], None], is_terminal: Callable[[int], bool] = os.isatty
) -> None:
    """Handle SIGHUP: a service reloads its files, a program stops if its terminal is gone.

    Args:
        reload: reads files again.
        stop: begins the stop; called if the terminal has hung up, where nobody could stop the server any more.
        is_terminal: returns True for a descriptor of a terminal that has not hung up.
    """
    began_in_terminal = is_terminal(STDIN)

    def handle() -> None:
        (stop if began_in_terminal and not is_terminal(STDIN) else reload)()

    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, handle)


def on_debug_signal() -> None:
    """Handle SIGUSR1: debug lines on, and off again."""
    asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, toggle_debug)


def toggle_debug() -> None:
    """Set the log's level to debug, or back to that of the settings."""
    debug = logging.getLogger(OUR_LOGGER).level != logging.DEBUG
    logs.change(LoggerLevel(OUR_LOGGER, logging.DEBUG if debug else logging.NOTSET))
    log.warning("SIGUSR1: the log's level is %s", "debug now" if debug else "again what the settings say")
