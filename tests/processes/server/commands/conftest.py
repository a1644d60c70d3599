"""The fixtures of the commands' tests, which are those of this ring too."""

from tests.server.commands.conftest import armbridge, emulator  # noqa: F401 - fixtures
