"""What holds for every test."""

from __future__ import annotations

from hypothesis import settings

# Imported before any test imports websockets: sets what that package reads when it is imported.
import server  # noqa: F401

# How long an example takes depends on the machine and on what else it does; no test is about that.
settings.register_profile("no-deadline", deadline=None)
settings.load_profile("no-deadline")
