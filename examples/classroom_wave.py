"""Wave between two points until Ctrl-C, then stop the arm; the server: ``armbridge serve``."""

import argparse
import itertools
import signal
import sys
import threading

from armbridge_client import ArmError, RequestRefused, connect  # pip install ./clients/python

POINTS = ((0.25, 0.12, 0.2), (0.25, -0.12, 0.2))
RETRY_PAUSE_S = 1


def main() -> None:
    """Wave until a signal comes, then stop the arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="ws://127.0.0.1:9090", help="the server (default: %(default)s)")
    arguments = parser.parse_args()
    ending = threading.Event()
    with connect(arguments.url) as arm:

        def end(_number: int, _frame: object) -> None:
            ending.set()
            arm.stop()

        # Registered before the first motion: a Ctrl-C in between must not leave the arm moving.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, end)
        for point in itertools.takewhile(lambda _: not ending.is_set(), itertools.cycle(POINTS)):
            try:
                arm.move_to(*point, speed=0.3)
                print("there", flush=True)
            except RequestRefused as refused:
                print(refused, flush=True)
                ending.wait(RETRY_PAUSE_S)
        print(arm.stop())


if __name__ == "__main__":
    try:
        main()
    except ArmError as error:
        sys.exit(str(error))
