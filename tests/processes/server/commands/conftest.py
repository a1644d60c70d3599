"""The fixtures of the commands' tests, which are those of this ring too."""

from tests.server.commands.conftest import (  # noqa: F401 - fixtures
    armbridge,
    bus,
    emulator,
    start_emulator,
    write_log,
)
