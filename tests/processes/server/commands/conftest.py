"""The fixtures of the commands' tests, which are those of this ring too."""

from tests.server.commands.conftest import (  # noqa: F401 - fixtures
    armbridge,
    armbridge_on_terminal,
    bus,
    emulator,
    start_emulator,
    start_terminal,
    terminal,
    write_log,
)
