"""The planning scene: objects that motions avoid, and objects that the arm holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from armbridge_client.connection import CALL_TIMEOUT_S, Connection
from armbridge_client.errors import RequestRefused
from armbridge_client.messages import (
    AllowedCollisionEntry,
    AllowedCollisionMatrix,
    ApplyPlanningSceneRequest,
    AttachedCollisionObject,
    CollisionObject,
    DeleteSceneRequest,
    GetPlanningSceneRequest,
    Header,
    ListScenesRequest,
    LoadSceneRequest,
    Mesh,
    MeshTriangle,
    PlanningScene,
    PlanningSceneComponents,
    PlanningSceneWorld,
    Point,
    Pose,
    PoseStamped,
    RobotState,
    SaveSceneRequest,
    SetBodyRequest,
    SolidPrimitive,
    TriggerRequest,
)
from armbridge_client.wire import Service

# Values of moveit_msgs/CollisionObject, shape_msgs/SolidPrimitive and moveit_msgs/PlanningSceneComponents.
ADD, REMOVE, BOX, SPHERE, CYLINDER = 0, 1, 1, 2, 3
WORLD_OBJECTS, ATTACHED_OBJECTS = 8 | 16, 4


class AsyncScene:
    """Planning scene of a server, which all its clients share. A change is in effect when its method returns.

    Poses of objects are made by :func:`armbridge_client.pose`. A change that the server refuses raises RequestRefused
    with the object, the field and the limit.

    Args:
        tip_link: link that holds objects if none is named.
    """

    def __init__(self, connection: Connection, tip_link: str) -> None:
        self._connection = connection
        self._tip_link = tip_link

    async def add_box(self, name: str, size_m: Sequence[float], at: PoseStamped) -> None:
        """Add a box, or replace the object of this name; ``size_m`` along x, y and z of the pose of its centre."""
        await self._add(name, SolidPrimitive(BOX, [float(each) for each in size_m]), at)

    async def add_sphere(self, name: str, radius_m: float, at: PoseStamped) -> None:
        """Add a sphere, or replace the object of this name."""
        await self._add(name, SolidPrimitive(SPHERE, [radius_m]), at)

    async def add_cylinder(self, name: str, height_m: float, radius_m: float, at: PoseStamped) -> None:
        """Add a cylinder along z of the pose of its centre, or replace the object of this name."""
        await self._add(name, SolidPrimitive(CYLINDER, [height_m, radius_m]), at)

    async def add_mesh(
        self, name: str, vertices_m: Sequence[Sequence[float]], triangles: Sequence[Sequence[int]], at: PoseStamped
    ) -> None:
        """Add a mesh, or replace the object of this name.

        Args:
            vertices_m: corners, shape (n, 3), in the axes of the pose.
            triangles: indices of corners, shape (m, 3).
        """
        mesh = Mesh(
            [MeshTriangle([int(index) for index in triangle]) for triangle in triangles],
            [Point(*(float(value) for value in vertex)) for vertex in vertices_m],
        )
        await self._change_object(
            CollisionObject(at.header, at.pose, name, meshes=[mesh], mesh_poses=[Pose()], operation=ADD)
        )

    async def remove(self, name: str) -> None:
        """Remove an object."""
        await self._change_object(CollisionObject(id=name, operation=REMOVE))

    async def clear(self) -> None:
        """Remove all objects; held objects stay."""
        await self._change_object(CollisionObject(operation=REMOVE))

    async def attach(self, name: str, *, link: str = "", touch_links: Sequence[str] = ()) -> None:
        """Make an object move with a link.

        Args:
            link: empty for the arm's tip.
            touch_links: further links that may touch the object, such as the fingers.
        """
        await self._change_held(name, link, touch_links, ADD)

    async def detach(self, name: str, *, link: str = "") -> None:
        """Put a held object back into the world, where it is now."""
        await self._change_held(name, link, (), REMOVE)

    async def allow_contact(self, *names: str) -> None:
        """Let objects and links of these names touch each other."""
        rows = [AllowedCollisionEntry([True] * len(names)) for _ in names]
        await self._apply(PlanningScene(allowed_collision_matrix=AllowedCollisionMatrix(list(names), rows)))

    async def make_movable(self, name: str, *, mass_kg: float = 0.0, friction: float = 0.0) -> None:
        """Let the physics of a simulated arm move an object.

        Args:
            mass_kg: 0 for a mass by its volume.
            friction: coefficient of friction, 0 for the default.
        """
        await self._carry_out_in_physics("/simulation/set_body", SetBodyRequest(name, True, mass_kg, friction))

    async def reset_physics(self) -> None:
        """Restore the world of a simulated arm with physics, and remove all objects, also out of the fingers."""
        await self._carry_out_in_physics("/simulation/reset", TriggerRequest())
        await self.clear()

    async def objects(self, timeout_s: float = CALL_TIMEOUT_S) -> dict[str, CollisionObject]:
        """Return the objects of the world by name."""
        request = GetPlanningSceneRequest(PlanningSceneComponents(WORLD_OBJECTS))
        scene = (await self._connection.call("/get_planning_scene", request, timeout_s)).scene
        return {each.id: each for each in scene.world.collision_objects}

    async def held(self, timeout_s: float = CALL_TIMEOUT_S) -> dict[str, AttachedCollisionObject]:
        """Return the held objects by name."""
        request = GetPlanningSceneRequest(PlanningSceneComponents(ATTACHED_OBJECTS))
        scene = (await self._connection.call("/get_planning_scene", request, timeout_s)).scene
        return {each.object.id: each for each in scene.robot_state.attached_collision_objects}

    async def save(self, name: str) -> str:
        """Save the scene on the server under a name; needs the role admin."""
        return (await self._connection.carry_out("/arm/scenes/save", SaveSceneRequest(name))).message

    async def load(self, name: str) -> str:
        """Replace the scene by a saved one."""
        return (await self._connection.carry_out("/arm/scenes/load", LoadSceneRequest(name))).message

    async def delete(self, name: str) -> str:
        """Delete a saved scene; needs the role admin."""
        return (await self._connection.carry_out("/arm/scenes/delete", DeleteSceneRequest(name))).message

    async def saved(self) -> list[str]:
        """Return the names of the saved scenes."""
        return (await self._connection.call("/arm/scenes/list", ListScenesRequest())).names

    async def _carry_out_in_physics(self, service: str, request: Service[Any]) -> None:
        try:
            await self._connection.carry_out(service, request)
        except RequestRefused as error:
            if "does not exist" in error.sentence:
                raise RequestRefused("this server has no physics: armbridge serve --simulation physics") from error
            raise

    async def _add(self, name: str, shape: SolidPrimitive, at: PoseStamped) -> None:
        await self._change_object(
            CollisionObject(at.header, at.pose, name, [shape], primitive_poses=[Pose()], operation=ADD)
        )

    async def _change_object(self, changed: CollisionObject) -> None:
        await self._apply(PlanningScene(world=PlanningSceneWorld([changed])))

    async def _change_held(self, name: str, link: str, touch_links: Sequence[str], operation: int) -> None:
        link = link or self._tip_link
        changed = CollisionObject(Header(), id=name, operation=operation)
        held = AttachedCollisionObject(link, changed, list(touch_links))
        await self._apply(PlanningScene(RobotState(attached_collision_objects=[held], is_diff=True)))

    async def _apply(self, scene: PlanningScene) -> None:
        scene.is_diff = scene.robot_state.is_diff = True
        await self._connection.carry_out("/apply_planning_scene", ApplyPlanningSceneRequest(scene))
