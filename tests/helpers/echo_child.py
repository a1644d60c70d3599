"""A child process that sends back what it gets, and ends when it is told to close or loses its server."""

from __future__ import annotations

from robot.processes import channel_of_child

if __name__ == "__main__":
    channel = channel_of_child()
    while not channel.closed:
        for message in channel.receive(None):
            if message == "close":
                raise SystemExit(0)
            channel.send(message)
