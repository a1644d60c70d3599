"""Worlds of the physics: files with a planning scene, and mass, friction and freedom of its objects."""

from collections.abc import Sequence
from pathlib import Path

from robot.physics.bodies import DEFAULT_FRICTION
from server.graph.message_types import MessageTypes
from server.moveit.messages import Message
from server.moveit.scene.saved_scene import MAX_SCENE_BYTES, complete_scene
from server.named_files import SUFFIX, read_json

FOLDER = Path(__file__).parents[2] / "worlds"  # of the worlds that come with the program

MAX_MASS_KG = 100.0
MAX_FRICTION = 10.0


def read_world(name: str, message_types: MessageTypes) -> tuple[Message, Sequence[Message]]:
    """Read a world by its name or path: its moveit_msgs/PlanningScene, and a request of SetBody for each of its bodies.

    Raises OSError, ValueError or MessageError.
    """
    known = sorted(path.stem for path in FOLDER.glob(f"*{SUFFIX}"))
    path = FOLDER / f"{name}{SUFFIX}" if name in known else Path(name).expanduser()
    if not path.is_file():
        raise ValueError(f"there is no such file; the built-in worlds are {', '.join(known)}")
    content = read_json(path, MAX_SCENE_BYTES)
    bodies = content.pop("bodies", []) if isinstance(content, dict) else []
    scene = complete_scene(message_types, content)
    listed = bodies if isinstance(bodies, list) else [bodies]
    requests = [message_types.complete("armbridge_msgs/srv/SetBody_Request", each) for each in listed]
    names = {each["id"] for each in scene["world"]["collision_objects"]}
    for at, request in enumerate(requests):
        if request["id"] not in names:
            raise ValueError(f"bodies[{at}].id: there is no object {request['id']!r} in the scene")
        if refusal := body_refusal(request):
            raise ValueError(f"bodies[{at}].{refusal}")
    return scene, requests


def body_refusal(request: Message) -> str:
    """Return the reason why no body has these figures of a request of SetBody; empty for none."""
    mass_kg, friction = request["mass"], request["friction"]
    if not 0.0 <= mass_kg <= MAX_MASS_KG:
        return f"mass must be 0 to {MAX_MASS_KG:g} kg, 0 for a mass by its volume, not {mass_kg:g}"
    if not 0.0 <= friction <= MAX_FRICTION:
        return f"friction must be 0 to {MAX_FRICTION:g}, 0 for {DEFAULT_FRICTION:g}, not {friction:g}"
    return ""
