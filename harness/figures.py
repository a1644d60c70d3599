"""Percentiles and tables."""

from collections.abc import Iterable, Sequence

import numpy as np

Row = Sequence[str]


def percentiles(values: Iterable[float], *shares: float, scale: float = 1e3, digits: int = 2) -> list[str]:
    """Return percentiles of values, scaled (seconds to milliseconds) and rounded."""
    array = np.fromiter(values, dtype=float)
    if not array.size:
        return ["-" for _ in shares]
    return [f"{np.percentile(array, share) * scale:.{digits}f}" for share in shares]


def print_table(title: str, header: Row, rows: Iterable[Row]) -> None:
    """Print a Markdown table under its title."""
    table = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(header))]
    print(f"\n### {title}\n")
    for number, row in enumerate(table):
        print("| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |")
        if number == 0:
            print("|" + "|".join("-" * (width + 2) for width in widths) + "|")
