"""Files of the source that one `/moveit_goal_pose` passes, from the socket to the servos and back.

Every process of a server notes the files whose functions run while a goal is under way. Files that also run while the
server is at rest, with its clock, its states and its health, are noted apart: a goal does not pass those on its way.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
from pathlib import Path

from harness.clients import frame_client
from harness.figures import print_table
from harness.server import RunningServer

ROOT = Path(__file__).parents[1]
ROOMS = ("server", "protocol", "planners", "robot")
# The planner workers load within this time, beside other work.
LOADING_S = 10.0
REST_S = 3.0

# A point in front of the arm, which it reaches in any orientation that its five joints allow.
POSE = {
    "header": {"frame_id": "base_link"},
    "pose": {"position": {"x": 0.2, "y": 0.05, "z": 0.15}, "orientation": {"w": 1.0}},
}

# Python imports a module of this name in every process at its start. A thread watches for a file that says when to note
# what runs; the profile function is set for all threads ahead, for it cannot be set for another thread later.
_SITECUSTOMIZE = """
import os, sys, threading, time
folder, rooms = {folder!r}, {rooms!r}
seen, noting = set(), False
def profile(frame, event, _argument):
    if noting and event == "call":
        seen.add(frame.f_code.co_filename)
def watch():
    global noting
    phase = ""
    while True:
        names = [name for name in os.listdir(folder) if name.startswith("phase-")]
        now = max(names, default="")
        if now != phase:
            if phase:
                ours = sorted(file for file in seen.copy() if file.startswith(rooms))
                with open(f"{{folder}}/{{phase.removeprefix('phase-')}}-{{os.getpid()}}", "w") as out:
                    out.write("\\n".join(ours))
            seen.clear()
            phase, noting = now, True
        time.sleep(0.02)
threading.setprofile(profile)
sys.setprofile(profile)
threading.Thread(target=watch, daemon=True).start()
"""


def run() -> None:
    """Send one goal of a pose, and print how many files of each room it passed."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        rooms = tuple(f"{ROOT / room}{os.sep}" for room in ROOMS)
        (folder / "sitecustomize.py").write_text(_SITECUSTOMIZE.format(folder=text, rooms=rooms))
        path = os.pathsep.join([text, *filter(None, [os.environ.get("PYTHONPATH")])])
        with RunningServer(settings={"PYTHONPATH": path}) as server:
            asyncio.run(_send_goal(server.url, folder))
        resting, moving = _noted(folder, "1-rest"), _noted(folder, "2-goal")
    rows = [[room, str(len(_of(room, moving))), str(len(_of(room, moving - resting)))] for room in ROOMS]
    rows.append(["all", str(len(moving)), str(len(moving - resting))])
    print_table("Files that a /moveit_goal_pose passes", ["room", "while it is under way", "not at rest"], rows)
    for name in sorted(moving - resting):
        print("  ", name)


async def _send_goal(url: str, folder: Path) -> None:
    async with frame_client(url) as client:
        await client.open_goals()
        await asyncio.sleep(LOADING_S)
        await _phase(folder, "1-rest", REST_S)
        (folder / "phase-2-goal").touch()
        await asyncio.sleep(0.1)
        result = await client.goal("/moveit_goal_pose", POSE)
        assert result["val"] == 1, result
        await _phase(folder, "3-end", 0.5)


async def _phase(folder: Path, name: str, duration_s: float) -> None:
    (folder / f"phase-{name}").touch()
    await asyncio.sleep(duration_s)


def _noted(folder: Path, phase: str) -> set[str]:
    files = {line for path in folder.glob(f"{phase}-*") for line in path.read_text().splitlines()}
    return {str(Path(file).relative_to(ROOT)) for file in files}


def _of(room: str, files: set[str]) -> set[str]:
    return {file for file in files if file.startswith(f"{room}/")}
