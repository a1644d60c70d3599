"""The settings of the section ``planning``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from planners.cluster.address import scheduler_address

MAX_WORKERS = 16


def _number_or_text(value: object) -> object:
    """Environment and command line have only texts: a number there means a number."""
    return int(value) if isinstance(value, str) and value.strip().lstrip("+-").isdecimal() else value


def _known_address(value: int | str) -> int | str:
    if isinstance(value, str):
        scheduler_address(value)
    elif not 1 <= value <= MAX_WORKERS:
        raise ValueError(f"must be 1 to {MAX_WORKERS}, or the address of a Dask scheduler as in dask://host:8786")
    return value


class PlanningSettings(BaseModel):
    """The planner processes, and a cluster beside them.

    Attributes:
        workers: how many goals may be planned at the same time, 1 to 16, by processes of this machine; one more process
            is kept as a warm spare. Or ``dask://host:8786``, the scheduler of a Dask cluster that plans beside
            ``local_workers`` of them; with ``dask+tls://`` by certificates.
        local_workers: how many goals may be planned at the same time on this machine when ``workers`` is a cluster.
        tls_authority: the certificate authority of ``dask+tls://``, in PEM; None without TLS.
        tls_certificate: this server's certificate, signed by it.
        tls_key: the certificate's key.
        memory_limit_mb: data that each process may hold; one that needs more is restarted [MB].
        save_failed_goals: directory for the goals that could not be planned, as files for ``armbridge plan``; None
            to keep none.
        keep_failed_goals: how many of these files are kept, the newest.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: Annotated[int | str, BeforeValidator(_number_or_text), AfterValidator(_known_address)] = 1
    local_workers: int = Field(default=1, ge=1, le=MAX_WORKERS)
    tls_authority: Path | None = None
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    memory_limit_mb: int = Field(default=1024, ge=256, le=65536)
    save_failed_goals: Path | None = None
    keep_failed_goals: int = Field(default=100, ge=1, le=100_000)

    @model_validator(mode="after")
    def _certificates_with_tls(self) -> PlanningSettings:
        files = {
            "tls_authority": self.tls_authority,
            "tls_certificate": self.tls_certificate,
            "tls_key": self.tls_key,
        }
        encrypted = self.cluster is not None and self.cluster.startswith("tls://")
        wrong = [name for name, file in files.items() if (file is not None) != encrypted]
        if wrong:
            raise ValueError(
                f"workers = {self.workers!r} {'needs' if encrypted else 'takes no'} {', '.join(wrong)}; "
                "dask+tls:// needs all three files, everything else none"
            )
        return self

    @property
    def memory_limit_bytes(self) -> int:
        """``memory_limit_mb`` as processes take it."""
        return self.memory_limit_mb * 1_000_000

    @property
    def cluster(self) -> str | None:
        """Address of the cluster's scheduler, as Dask writes it; None without a cluster."""
        return scheduler_address(self.workers) if isinstance(self.workers, str) else None

    @property
    def active_here(self) -> int:
        """How many goals may be planned at the same time by processes of this machine."""
        return self.workers if isinstance(self.workers, int) else self.local_workers
