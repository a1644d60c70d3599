"""Numbers of random examples, which follow the profile of Hypothesis that is loaded."""

from __future__ import annotations

import math

from hypothesis import settings

# The profile `ci` draws this many examples of a test that names no number.
EXAMPLES_IN_CI = 100


def examples(count: int) -> settings:
    """Settings of a test that draws ``count`` examples in CI, and in proportion with another profile."""
    return settings(max_examples=in_proportion(count))


def in_proportion(count: int) -> int:
    """Return ``count`` in CI, and its share with another profile, for tests that draw at random by themselves."""
    return math.ceil(count * settings.default.max_examples / EXAMPLES_IN_CI)
