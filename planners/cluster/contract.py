"""What server and Dask workers must have in common before they exchange pickled dataclasses."""

from __future__ import annotations

import functools
import hashlib
from importlib import metadata, resources

# All that is pickled, and all that makes the answers, is defined there.
_SOURCES = (("planners", "**/*.py"), ("robot", "model.py"), ("robot", "trajectory.py"))


@functools.cache
def contract() -> str:
    """Version of armbridge and a digest of the code of its planners, as in ``0.1.0 (planners 3fa2b1c4)``."""
    digest = hashlib.sha256()
    for package, pattern in _SOURCES:
        with resources.as_file(resources.files(package)) as folder:
            for path in sorted(folder.glob(pattern)):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return f"{metadata.version('armbridge')} (planners {digest.hexdigest()[:8]})"
