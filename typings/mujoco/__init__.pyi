from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Vector = NDArray[np.float64]

class mjtIntegrator:
    mjINT_IMPLICITFAST: int

class mjtCone:
    mjCONE_ELLIPTIC: int

class mjtDisableBit:
    mjDSBL_AUTORESET: int
    mjDSBL_CONTACT: int

class mjtGeom:
    mjGEOM_PLANE: int
    mjGEOM_SPHERE: int
    mjGEOM_CYLINDER: int
    mjGEOM_BOX: int
    mjGEOM_MESH: int

class mjtEq:
    mjEQ_JOINT: int

class mjtOrientation:
    mjORIENTATION_XYAXES: int

class MjsOrientation:
    type: int
    xyaxes: list[float]

class MjsCamera:
    alt: MjsOrientation

class mjtObj:
    mjOBJ_JOINT: int
    mjOBJ_BODY: int

class MjsOption:
    timestep: float
    integrator: int
    cone: int
    impratio: float
    disableflags: int

class MjsGeom:
    contype: int
    conaffinity: int
    condim: int
    density: float
    friction: list[float]
    mass: float
    meshname: str
    priority: int

class MjsJoint:
    name: str
    armature: float

class MjsMesh:
    name: str

class MjsEquality:
    type: int
    objtype: int
    data: Any

class MjsBody:
    name: str
    mocap: bool
    mass: float
    explicitinertial: bool
    geoms: list[MjsGeom]
    def add_geom(self, **values: object) -> MjsGeom: ...
    def add_camera(self, **values: object) -> MjsCamera: ...
    def add_body(self, **values: object) -> MjsBody: ...
    def add_freejoint(self, **values: object) -> MjsJoint: ...

class MjsHeadlight:
    ambient: list[float]
    diffuse: list[float]

class MjsGlobal:
    offwidth: int
    offheight: int

class MjsMap:
    znear: float
    zfar: float

class MjsVisual:
    headlight: MjsHeadlight
    global_: MjsGlobal
    map: MjsMap

class MjSpec:
    visual: MjsVisual
    option: MjsOption
    bodies: list[MjsBody]
    joints: list[MjsJoint]
    worldbody: MjsBody
    @staticmethod
    def from_string(xml: str, assets: Mapping[str, bytes] | None = None) -> MjSpec: ...
    def add_mesh(self, **values: object) -> MjsMesh: ...
    def add_exclude(self, **values: object) -> object: ...
    def add_equality(self, **values: object) -> MjsEquality: ...
    def body(self, name: str) -> MjsBody | None: ...
    def delete(self, element: object) -> None: ...
    def compile(self) -> MjModel: ...
    def recompile(self, model: MjModel, data: MjData) -> tuple[MjModel, MjData]: ...

class _Named:
    id: int
    name: str

class _Body(_Named):
    mocapid: NDArray[np.int32]
    jntadr: NDArray[np.int32]
    dofadr: NDArray[np.int32]

class MjStatistic:
    extent: float

class MjModel:
    vis: MjsVisual
    stat: MjStatistic
    nq: int
    nv: int
    nbody: int
    ngeom: int
    body_mass: _Vector
    body_jntadr: NDArray[np.int32]
    geom_bodyid: NDArray[np.int32]
    ncam: int
    cam_bodyid: NDArray[np.int32]
    geom_rgba: NDArray[np.float32]
    jnt_range: _Vector
    jnt_limited: NDArray[np.bool_]
    jnt_actfrcrange: _Vector
    jnt_qposadr: NDArray[np.int32]
    jnt_dofadr: NDArray[np.int32]
    dof_damping: _Vector
    def joint(self, name: str | int) -> _Named: ...
    def body(self, name: str | int) -> _Body: ...

class MjData:
    qpos: _Vector
    mocap_pos: _Vector
    mocap_quat: _Vector
    qvel: _Vector
    qfrc_applied: _Vector
    qfrc_bias: _Vector
    xpos: _Vector
    xquat: _Vector
    ncon: int
    contact: Any
    def __init__(self, model: MjModel) -> None: ...

def mj_step(m: MjModel, d: MjData, nstep: int = ...) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_resetData(m: MjModel, d: MjData) -> None: ...
def mj_mulM(m: MjModel, d: MjData, res: _Vector, vec: _Vector) -> None: ...
def set_mju_user_warning(handler: Callable[[str], None] | None) -> None: ...

class Renderer:
    def __init__(self, model: MjModel, height: int = ..., width: int = ...) -> None: ...
    def update_scene(self, data: MjData, camera: int | str = ...) -> None: ...
    def enable_depth_rendering(self) -> None: ...
    def disable_depth_rendering(self) -> None: ...
    def render(self) -> NDArray[Any]: ...
    def close(self) -> None: ...
