"""The fixtures of the server's tests, which are those of this ring too."""

from tests.server.conftest import client, served  # noqa: F401 - fixtures
