"""Move the arm to a named target: ``python named_goal.py [NAME] [PORT]``."""

from __future__ import annotations

import sys
import threading
from typing import Any

import roslibpy

CONNECT_TIMEOUT_S = 5
MOTION_TIMEOUT_S = 30


def main(name: str = "ready", port: str = "9090") -> int:
    """Send the goal, wait for its answer, and return 0 when the arm is there."""
    client = roslibpy.Ros(host="127.0.0.1", port=int(port))
    client.run(timeout=CONNECT_TIMEOUT_S)

    answers: list[dict[str, Any]] = []
    answered = threading.Event()

    def take_answer(answer: dict[str, Any]) -> None:
        # Everybody's answers come here; the source is the topic of the goal and its number.
        if answer["source"].startswith("/moveit_goal_named#"):
            answers.append(answer)
            answered.set()

    roslibpy.Topic(client, "/moveit_goal_result", "moveit_msgs/MoveItErrorCodes").subscribe(take_answer)
    roslibpy.Topic(client, "/moveit_goal_named", "std_msgs/String").publish(roslibpy.Message({"data": name}))

    in_time = answered.wait(MOTION_TIMEOUT_S)
    client.terminate()
    if not in_time:
        print(f"no answer within {MOTION_TIMEOUT_S} s")
        return 1
    print(answers[0]["val"], answers[0]["message"])
    return 0 if answers[0]["val"] == 1 else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
