"""Continuous collision against queries whose answers were found symbolically.

The queries are those of the benchmark of Wang et al. (2021): eight points, each coordinate a rational number, and whether
there is a contact. They lie in the folder ccd of CADSCULPT_CORPUS.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np

from cadsculpt.collide.continuous.primitives import edge_edge, vertex_face


def read_queries(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 8, 3), four at the start and four at the end of the step, and truth (n,) of a file of queries.

    Raises ValueError for a coordinate that is no double: rounding it would ask another question.
    """
    with path.open(newline="") as file:
        rows = [[int(x) for x in row] for row in csv.reader(file)]
    points = np.empty((len(rows), 3))
    for i, row in enumerate(rows):
        for c in range(3):
            numerator, denominator = row[2 * c : 2 * c + 2]
            points[i, c] = numerator / denominator
            exact, power = points[i, c].item().as_integer_ratio()
            if exact * denominator != numerator * power:
                raise ValueError(f"{path.name} line {i + 1}: {numerator}/{denominator} is no double")
    return points.reshape(-1, 8, 3), np.array([row[6] for row in rows[::8]], dtype=bool)


def ccd_truth() -> dict[str, int]:
    """Queries, negatives among them, and how often the answer was wrong either way."""
    counts = {"ccd_queries": 0, "ccd_negatives": 0, "ccd_false_negative": 0, "ccd_false_positive": 0}
    files = sorted((Path(os.environ["CADSCULPT_CORPUS"]) / "ccd").glob("*.csv"))
    if not files:
        raise FileNotFoundError("no queries in the folder ccd of CADSCULPT_CORPUS")
    for path in files:
        points, truth = read_queries(path)
        solve = edge_edge if "edge-edge" in path.name else vertex_face
        hit = solve(points[:, :4], points[:, 4:]).hit
        counts["ccd_queries"] += len(truth)
        counts["ccd_negatives"] += int((~truth).sum())
        counts["ccd_false_negative"] += int((truth & ~hit).sum())
        counts["ccd_false_positive"] += int((hit & ~truth).sum())
    return counts


if __name__ == "__main__":
    print(ccd_truth())
