"""A child process that sends back what it gets, and ends when it is told to close or loses its server.

Bytes after the word "raw" are sent as they are, whether they are a message or not. What follows the word "log" is
logged.
"""

import logging
import os

from robot.channel import channel_of_child

if __name__ == "__main__":
    channel = channel_of_child()
    while not channel.closed:
        for message in channel.receive(None):
            if message == "close":
                raise SystemExit(0)
            if isinstance(message, tuple) and message[0] == "raw":
                os.write(channel.fileno(), message[1])
                continue
            if isinstance(message, tuple) and message[0] == "log":
                _, name, level, text = message
                logging.getLogger(name).log(level, text)
                continue
            channel.send(message)
