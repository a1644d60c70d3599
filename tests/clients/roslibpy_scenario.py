"""What a Python program does with the old roslibpy, step by step; prints one JSON object: step -> what came back.

Usage: python roslibpy_scenario.py PORT
"""

import json
import sys
import threading
import time
from typing import Any

import roslibpy
from roslibpy import actionlib

STEP_TIMEOUT_S = 120.0
FIBONACCI = ("/fibonacci", "actionlib_tutorials/FibonacciAction")


class Heard:
    """The first answer to something, waited for no longer than a step may take."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._value: Any = None

    def __call__(self, value: Any) -> None:
        self._value = value
        self._event.set()

    def wait(self, step: str) -> Any:
        if not self._event.wait(STEP_TIMEOUT_S):
            raise TimeoutError(f"{step}: no answer")
        return self._value


def first_message(client: roslibpy.Ros, name: str, message_type: str) -> Heard:
    heard = Heard()
    roslibpy.Topic(client, name, message_type).subscribe(lambda message: heard(dict(message)))
    return heard


def main(port: int) -> dict[str, Any]:
    client, other = (roslibpy.Ros(host="127.0.0.1", port=port) for _ in range(2))
    client.run()
    other.run()
    answers: dict[str, Any] = {
        "topics": client.get_topics(),
        "topic type": client.get_topic_type("/joint_states"),
        "services": client.get_services(),
        "joint states": first_message(client, "/joint_states", "sensor_msgs/JointState").wait("joint states"),
        "relayed": relayed(client, other),
        "offered service": offered_service(client, other),
        "failed service": failed_service(client, other),
        "unknown service": unknown_service(client),
        "goal": goal(client),
        "fibonacci": fibonacci(client, other),
        "unknown parameter": client.get_param("/nobody_has_set_this"),
    }
    client.set_param("/speed", 0.5)
    answers["parameter"] = client.get_param("/speed")
    client.terminate()
    return answers


def relayed(client: roslibpy.Ros, other: roslibpy.Ros) -> str:
    heard = first_message(other, "/chatter", "std_msgs/String")
    talker = roslibpy.Topic(client, "/chatter", "std_msgs/String")
    for _ in range(100):
        talker.publish(roslibpy.Message({"data": "hello"}))
        time.sleep(0.02)
    return str(heard.wait("relayed")["data"])


def offered_service(client: roslibpy.Ros, other: roslibpy.Ros) -> dict[str, Any]:
    def switch(request: dict[str, Any], response: roslibpy.ServiceResponse) -> bool:
        response["success"] = request["data"]
        response["message"] = "on" if request["data"] else "off"
        return True

    roslibpy.Service(client, "/switch", "std_srvs/SetBool").advertise(switch)
    time.sleep(0.3)
    caller = roslibpy.Service(other, "/switch", "std_srvs/SetBool")
    return dict(caller.call(roslibpy.ServiceRequest({"data": True}), timeout=STEP_TIMEOUT_S))


def failed_service(client: roslibpy.Ros, other: roslibpy.Ros) -> dict[str, Any]:
    def refuse(_request: dict[str, Any], response: roslibpy.ServiceResponse) -> bool:
        response["message"] = "busy"
        return False

    roslibpy.Service(client, "/refuse", "std_srvs/SetBool").advertise(refuse)
    time.sleep(0.3)
    caller = roslibpy.Service(other, "/refuse", "std_srvs/SetBool")
    return dict(caller.call(roslibpy.ServiceRequest({"data": True}), timeout=STEP_TIMEOUT_S))


def unknown_service(client: roslibpy.Ros) -> str:
    try:
        roslibpy.Service(client, "/nobody", "std_srvs/Trigger").call(roslibpy.ServiceRequest(), timeout=STEP_TIMEOUT_S)
    except Exception as error:
        return str(error)
    return ""


def goal(client: roslibpy.Ros) -> dict[str, Any]:
    result = first_message(client, "/moveit_goal_result", "moveit_msgs/MoveItErrorCodes")
    roslibpy.Topic(client, "/moveit_goal_named", "std_msgs/String").publish(roslibpy.Message({"data": "ready"}))
    return dict(result.wait("goal"))


def numbers(order: int) -> list[int]:
    sequence = [0, 1]
    while len(sequence) <= order:
        sequence.append(sequence[-1] + sequence[-2])
    return sequence


def fibonacci(client: roslibpy.Ros, other: roslibpy.Ros) -> dict[str, Any]:
    """The example of actionlib, with its client and its server."""
    server = actionlib.SimpleActionServer(other, *FIBONACCI)

    def calculate(asked: dict[str, Any]) -> None:
        server.send_feedback({"sequence": numbers(2)})
        server.set_succeeded({"sequence": numbers(asked["order"])})

    server.start(calculate)
    asked = actionlib.Goal(actionlib.ActionClient(client, *FIBONACCI), roslibpy.Message({"order": 7}))
    feedback = Heard()
    asked.on("feedback", lambda told: feedback(dict(told)))
    asked.send()
    result = asked.wait(STEP_TIMEOUT_S)
    return {"result": dict(result), "feedback": feedback.wait("feedback")}


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]))))
