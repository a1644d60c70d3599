"""The planning cluster that the settings name."""

from __future__ import annotations

from importlib.util import find_spec

from planners.cluster.cluster import Cluster, TlsFiles
from planners.pool import PlannerPool
from robot.description.model import RobotModel
from server.errors import ConfigurationError
from server.planning_settings import PlanningSettings


def planning_cluster(settings: PlanningSettings, robot: RobotModel, pool: PlannerPool) -> Cluster | None:
    """The cluster whose workers join the pool once it is started; None when the settings name none.

    Args:
        settings: the section ``planning``.
        robot: the arm to plan for.
        pool: what they join.

    Raises:
        ConfigurationError: it cannot be used.
    """
    if settings.cluster is None:
        return None
    if find_spec("distributed") is None:
        raise ConfigurationError(
            f"planning.workers: {settings.workers} needs the package distributed: pip install 'armbridge[dask]'"
        )
    return Cluster(settings.cluster, robot, settings.memory_limit_bytes, pool, _tls(settings))


def _tls(settings: PlanningSettings) -> TlsFiles | None:
    authority, certificate, key = settings.tls_authority, settings.tls_certificate, settings.tls_key
    if authority is None or certificate is None or key is None:
        return None
    for name, file in (("authority", authority), ("certificate", certificate), ("key", key)):
        try:
            file.read_bytes()
        except OSError as error:
            raise ConfigurationError(f"planning.tls_{name}: {error}") from error
    return TlsFiles(authority, certificate, key)
