"""``python -m benchmarks [NAME ...]``: run the benchmarks and print their tables."""

from __future__ import annotations

import argparse
import importlib
import os
import platform

# Modules of this folder, each with a function ``run``.
BENCHMARKS = (
    "processes",
    "goal_latency",
    "planning",
    "published_arms",
    "planner_processes",
    "planning_scenes",
    "planning_growth",
    "planning_passages",
    "busy_machine",
    "servo_loop",
    "physics",
    "servo_stream",
    "joint_states",
    "page",
    "page_jog",
    "gateway",
    "recording",
    "start",
    "stops",
    "recovery",
    "floods",
    "one_frame",
    "classroom",
    "several_arms",
    "teleop",
    "chunks",
    "soak",
    "planning_scene_services",
    "pick_and_place",
)


def main() -> None:
    """Run the named benchmarks, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=main.__doc__)
    parser.add_argument("names", nargs="*", choices=[*BENCHMARKS, []], metavar="NAME", help=", ".join(BENCHMARKS))
    names = parser.parse_args().names or BENCHMARKS
    print(f"Python {platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores")
    for name in names:
        importlib.import_module(f"benchmarks.{name}").run()


if __name__ == "__main__":
    main()
