"""What clients set by ``/set_planner_params``: kept in memory, by planning group and planner."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import ValidationError

from server.errors import ServiceError
from server.moveit.parameters import MoveItParameters

# Far more than MoveIt's own planners have.
MAX_KEYS = 200
MAX_CONFIGURATIONS = 100

# Those of the parameters that say how is planned, and may be set while the server runs.
KNOWN_KEYS = (
    "allowed_planning_time",
    "joint_tolerance",
    "num_planning_attempts",
    "optimization_time",
    "planner_id",
    "position_tolerance",
)


class PlannerParameters:
    """The parameters that requests are read with.

    Keys other than `KNOWN_KEYS`, such as those of OMPL's planners, are kept and told, and change nothing.

    Args:
        configured: those of the configuration.
    """

    def __init__(self, configured: MoveItParameters) -> None:
        self._configured = configured
        self._set: dict[tuple[str, str], dict[str, str]] = {}

    def of(self, group: str = "", planner: str = "") -> MoveItParameters:
        """The parameters of a planner in a group; empty names mean the configured ones.

        What is set for all groups, or all planners, counts where nothing else is.
        """
        texts = self.texts(group or self._configured.group_name, planner or self._configured.planner_id)
        known = {key: value for key, value in texts.items() if key in KNOWN_KEYS}
        return self._changed(known)

    def texts(self, group: str, planner: str) -> Mapping[str, str]:
        """Every parameter as text."""
        texts = {key: str(getattr(self._configured, key)) for key in KNOWN_KEYS}
        for scope in (("", ""), (group, ""), (group, planner)):
            texts |= self._set.get(scope, {})
        return texts

    def set(self, group: str, planner: str, values: Mapping[str, str], *, replace: bool) -> None:
        """Set parameters.

        Args:
            group: for which group; empty for all.
            planner: for which planner; empty for all.
            values: by name.
            replace: whether what was set there before is forgotten.

        Raises:
            ServiceError: a known parameter whose value cannot be, or too many; nothing is changed.
        """
        scope = (group, planner)
        kept = {} if replace else self._set.get(scope, {})
        wanted = {**kept, **values}
        if len(wanted) > MAX_KEYS or len({*self._set, scope}) > MAX_CONFIGURATIONS:
            raise ServiceError(f"at most {MAX_KEYS} parameters of {MAX_CONFIGURATIONS} planners can be kept")
        self._changed({key: value for key, value in wanted.items() if key in KNOWN_KEYS})
        self._set[scope] = wanted

    def _changed(self, known: Mapping[str, str]) -> MoveItParameters:
        try:
            return MoveItParameters.model_validate({**self._configured.model_dump(), **known})
        except ValidationError as error:
            flaw = error.errors()[0]
            raise ServiceError(f"{flaw['loc'][0]}: {flaw['msg']}, not {flaw['input']!r}") from error
