"""A child process that sends back what it gets, and ends when it is told to close or loses its server.

Bytes after the word "raw" are sent as they are, whether they are a message or not. What follows the word "log" is
logged, and the number after "exit" is the exit code. With a first message after the word "template" it is a template,
which sleeps or ends while it loads if that is the message; its copies know it.
"""

import logging
import os
import sys
import time

from robot.channel import Channel, channel_of_child
from robot.template import serve_copies


def load(first: object) -> None:
    """Load as a template does whose first message that is."""
    if first == "hangs":
        time.sleep(60.0)
    if first == "ends":
        sys.exit(3)


def echo(channel: Channel, known: object = None) -> None:
    """Send back what comes, until the server has gone; the answer to the word "known" is what the template knew."""
    while not channel.closed:
        for message in channel.receive(None):
            match message:
                case "close":
                    raise SystemExit(0)
                case "known":
                    channel.send(known)
                case ("raw", data):
                    os.write(channel.fileno(), data)
                case ("log", name, level, text):
                    logging.getLogger(name).log(level, text)
                case ("exit", code):
                    os._exit(code)
                case ("template", first):
                    load(first)
                    serve_copies(channel)
                    known = first
                case _:
                    channel.send(message)


if __name__ == "__main__":
    echo(channel_of_child())
