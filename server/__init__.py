"""The server: rosbridge clients on one side, planners and the arm on the other.

An argument ``clock`` or ``now_s`` is monotonic time [s], ``wall_clock`` seconds since the epoch; ``call_later`` calls a
function after a delay, as :mod:`server.timers` does.
"""

import os

# Clients such as ros-sharp send frames of 1024 bytes, and the default of 4096 frames would end their messages at 4 MiB.
# The websockets package reads this variable when it is imported, so it is set before any module of the server is.
os.environ.setdefault("WEBSOCKETS_MAX_FRAGMENTS", "16384")
