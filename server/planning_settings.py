"""The settings of the section ``planning``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _no_cluster(value: object) -> object:
    if isinstance(value, str) and "://" in value:
        raise ValueError(
            "must be 1 to 16: a server plans on its own machine only; a Dask cluster plans batches of problems, by"
            " armbridge plan FILE --scheduler tcp://HOST:PORT"
        )
    return value


class PlanningSettings(BaseModel):
    """The planner processes.

    Attributes:
        workers: how many goals may be planned at the same time; one more process is kept as a warm spare.
        memory_limit_mb: data that each process may hold; one that needs more is restarted [MB].
        save_failed_goals: directory for the goals that could not be planned, as files for ``armbridge plan``; None
            to keep none.
        keep_failed_goals: how many of these files are kept, the newest.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: Annotated[int, BeforeValidator(_no_cluster)] = Field(default=1, ge=1, le=16)
    memory_limit_mb: int = Field(default=1024, ge=256, le=65536)
    save_failed_goals: Path | None = None
    keep_failed_goals: int = Field(default=100, ge=1, le=100_000)

    @property
    def memory_limit_bytes(self) -> int:
        """``memory_limit_mb`` as processes take it."""
        return self.memory_limit_mb * 1_000_000
