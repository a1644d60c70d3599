"""``python -m benchmarks [NAME ...]``: run the benchmarks and print their tables."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Callable

from benchmarks import (
    busy_machine,
    classroom,
    event_loop,
    floods,
    gateway,
    goal_latency,
    joint_states,
    one_frame,
    page,
    page_jog,
    planner_processes,
    planning,
    planning_growth,
    planning_passages,
    planning_random,
    planning_scene_services,
    planning_scenes,
    processes,
    published_arms,
    queued_goals,
    recording,
    recovery,
    servo_loop,
    servo_stream,
    several_arms,
    soak,
    start,
    stops,
    teleop,
)

BENCHMARKS: dict[str, Callable[[], None]] = {
    "processes": processes.run,
    "goal_latency": goal_latency.run,
    "planning": planning.run,
    "published_arms": published_arms.run,
    "queued_goals": queued_goals.run,
    "planner_processes": planner_processes.run,
    "planning_scenes": planning_scenes.run,
    "planning_random": planning_random.run,
    "planning_growth": planning_growth.run,
    "planning_passages": planning_passages.run,
    "busy_machine": busy_machine.run,
    "servo_loop": servo_loop.run,
    "servo_stream": servo_stream.run,
    "joint_states": joint_states.run,
    "page": page.run,
    "page_jog": page_jog.run,
    "event_loop": event_loop.run,
    "gateway": gateway.run,
    "recording": recording.run,
    "start": start.run,
    "stops": stops.run,
    "recovery": recovery.run,
    "floods": floods.run,
    "one_frame": one_frame.run,
    "classroom": classroom.run,
    "several_arms": several_arms.run,
    "teleop": teleop.run,
    "soak": soak.run,
    "planning_scene_services": planning_scene_services.run,
}


def main() -> None:
    """Run the named benchmarks, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=main.__doc__)
    parser.add_argument("names", nargs="*", choices=[*BENCHMARKS, []], metavar="NAME", help=", ".join(BENCHMARKS))
    names = parser.parse_args().names or list(BENCHMARKS)
    print(f"Python {platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores")
    for name in names:
        BENCHMARKS[name]()


if __name__ == "__main__":
    main()
