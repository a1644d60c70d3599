"""SIGHUP: a service is told to read its files again; a program in a terminal, that the terminal is gone."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable

STDIN = 0


def on_hangup(reload: Callable[[], None], end: Callable[[], None], terminal: Callable[[int], bool] = os.isatty) -> None:
    """Handle SIGHUP from now on.

    Args:
        reload: reads files again.
        end: begins the end; called when the terminal that there was is gone, for nobody could end the server there.
        terminal: whether a descriptor is a terminal; it is none any more when it has hung up.
    """
    began_in_terminal = terminal(STDIN)

    def take() -> None:
        (end if began_in_terminal and not terminal(STDIN) else reload)()

    asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, take)
