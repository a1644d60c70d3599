"""Lines and branches of the four packages that a run of `make test` reached, from its report in JSON; fails below 90 %.

``make test ARGS="--cov --cov-report=json:build/coverage.json"``, then ``python -m tests.package_coverage``.
"""

import json
import sys
from collections import Counter

from harness.figures import print_table
from harness.server import ROOT
from tests.helpers.source import PACKAGES

REPORT = ROOT / "build" / "coverage.json"
LEAST_PERCENT = 90.0


def main() -> int:
    """Print a table; return 1 where lines and branches together are reached too seldom."""
    files = json.loads(REPORT.read_text())["files"]
    counts = {package: Counter[str]() for package in PACKAGES}
    for name, file in files.items():
        counts[name.split("/")[0]].update({key: n for key, n in file["summary"].items() if isinstance(n, int)})
    counts["all"] = sum(counts.values(), Counter())
    rows = [[package, *(f"{percent:.1f}" for percent in _percents(count))] for package, count in counts.items()]
    print_table(f"Reached by make test [%], at least {LEAST_PERCENT:g} of all", ["", "lines", "branches", "both"], rows)
    return int(_percents(counts["all"])[2] < LEAST_PERCENT)


def _percents(count: Counter[str]) -> tuple[float, float, float]:
    lines, branches = count["covered_lines"], count["covered_branches"]
    all_lines, all_branches = count["num_statements"], count["num_branches"]
    both = (lines + branches) / (all_lines + all_branches)
    return 100.0 * lines / all_lines, 100.0 * branches / all_branches, 100.0 * both


if __name__ == "__main__":
    sys.exit(main())
