from enum import Enum

class ControlInterface(Enum):
    Position = ...
    Velocity = ...

class Synchronization(Enum):
    No = ...
    Time = ...

class Result(Enum):
    Working = ...
    Finished = ...

class RuckigError(Exception): ...

class InputParameter:
    current_position: list[float]
    current_velocity: list[float]
    current_acceleration: list[float]
    target_position: list[float]
    target_velocity: list[float]
    target_acceleration: list[float]
    max_velocity: list[float]
    max_acceleration: list[float]
    max_jerk: list[float]
    minimum_duration: float
    synchronization: Synchronization
    per_dof_synchronization: list[Synchronization]
    per_dof_control_interface: list[ControlInterface]
    def __init__(self, dofs: int) -> None: ...

class BrakeProfile:
    t: tuple[float, float]

class Profile:
    brake: BrakeProfile
    t: tuple[float, ...]

class Trajectory:
    duration: float
    profiles: list[list[Profile]]
    def __init__(self, dofs: int) -> None: ...
    def at_time(self, time: float) -> tuple[list[float], list[float], list[float]]: ...

class Ruckig:
    def __init__(self, dofs: int) -> None: ...
    def calculate(self, given: InputParameter, trajectory: Trajectory, /) -> Result: ...
