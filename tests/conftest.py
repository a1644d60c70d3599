"""What holds for every test."""

from __future__ import annotations

# Imported before any test imports websockets: sets what that package reads when it is imported.
import server  # noqa: F401
