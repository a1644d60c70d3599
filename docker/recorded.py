"""Tells what a recording holds: ``python recorded.py FILE.mcap``. Needs ``mcap``.

Ends with exit code 1 if there are no joint states in it.
"""

from __future__ import annotations

import sys
from pathlib import Path

from mcap.reader import make_reader


def main(arguments: list[str]) -> int:
    """Read the file's summary."""
    with Path(arguments[0]).open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None or summary.statistics is None:
        sys.exit(f"{arguments[0]} was not ended")
    topics = {channel.topic for channel in summary.channels.values()}
    sys.stdout.write(f"recording: {summary.statistics.message_count} messages on {len(topics)} topics\n")
    return 0 if "/joint_states" in topics else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
