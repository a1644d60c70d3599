"""Answers of services whose response begins with ``success`` and ``message``."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeAlias

from server.errors import ServiceError

Work: TypeAlias = Callable[[Mapping[str, Any]], Awaitable[dict[str, Any]]]


def telling(name: str, work: Work, log: logging.Logger) -> Work:
    """Return a service that answers a ServiceError of `work` without success, and logs it."""

    async def serve(request: Mapping[str, Any]) -> dict[str, Any]:
        try:
            return await work(request)
        except ServiceError as error:
            log.warning("%s: %s", name, error)
            return {"success": False, "message": str(error)}

    return serve
