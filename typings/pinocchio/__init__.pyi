"""The part of pinocchio 3.8 that is used."""

from collections.abc import Iterator, Sequence
from enum import Enum

import numpy as np
from coal import CollisionGeometry, CollisionRequest, DistanceResult
from numpy.typing import NDArray

_Vector = NDArray[np.float64]

class SE3:
    translation: _Vector
    def act(self, point: _Vector) -> _Vector: ...

class Frame:
    name: str
    parentJoint: int
    placement: SE3

class JointData:
    S: _Vector

class JointModel:
    idx_v: int
    def createData(self) -> JointData: ...
    def calc(self, data: JointData, q: _Vector) -> None: ...

class Data: ...

class Model:
    names: Sequence[str]
    frames: Sequence[Frame]
    joints: Sequence[JointModel]
    parents: Sequence[int]
    jointPlacements: Sequence[SE3]
    njoints: int
    nv: int
    lowerPositionLimit: _Vector
    upperPositionLimit: _Vector
    def createData(self) -> Data: ...
    def getFrameId(self, name: str) -> int: ...

class GeometryType(Enum):
    COLLISION = ...

class GeometryObject:
    name: str
    parentJoint: int
    parentFrame: int
    placement: SE3
    geometry: CollisionGeometry
    def __init__(
        self,
        name: str,
        parent_joint: int,
        parent_frame: int,
        placement: SE3,
        collision_geometry: CollisionGeometry,
    ) -> None: ...

class CollisionPair:
    first: int
    second: int
    def __init__(self, first: int, second: int) -> None: ...

class _CollisionPairs:
    def __iter__(self) -> Iterator[CollisionPair]: ...
    def __len__(self) -> int: ...

class GeometryData:
    collisionRequests: Sequence[CollisionRequest]

class GeometryModel:
    ngeoms: int
    geometryObjects: Sequence[GeometryObject]
    collisionPairs: _CollisionPairs
    def addGeometryObject(self, shape: GeometryObject) -> int: ...
    def addCollisionPair(self, pair: CollisionPair) -> None: ...
    def createData(self) -> GeometryData: ...

class BroadPhaseManager_DynamicAABBTreeCollisionManager:
    def __init__(self, model: Model, geometry_model: GeometryModel, geometry_data: GeometryData) -> None: ...

def buildModelFromXML(urdf: str) -> Model: ...
def buildGeomFromUrdfString(
    model: Model, urdf_string: str, geom_type: GeometryType, *, package_dirs: Sequence[str]
) -> GeometryModel: ...
def neutral(model: Model) -> _Vector: ...
def forwardKinematics(model: Model, data: Data, q: _Vector) -> None: ...
def updateFramePlacement(model: Model, data: Data, frame_id: int) -> SE3: ...
def updateGeometryPlacements(
    model: Model, data: Data, geometry_model: GeometryModel, geometry_data: GeometryData, q: _Vector
) -> None: ...
def computeCollision(geometry_model: GeometryModel, geometry_data: GeometryData, pair_index: int) -> bool: ...
def computeDistance(geometry_model: GeometryModel, geometry_data: GeometryData, pair_index: int) -> DistanceResult: ...
def computeCollisions(
    model: Model,
    data: Data,
    broadphase: BroadPhaseManager_DynamicAABBTreeCollisionManager,
    q: _Vector,
    stop_at_first: bool,
) -> bool: ...
