"""Fixtures of the arm's tests in this ring: servos on a pseudo terminal, as a process or scripted."""

from tests.robot.conftest import scripted_peer, start_terminal, terminal  # noqa: F401 - fixtures
