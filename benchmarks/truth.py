"""What is claimed of the collision, shown true: `python benchmarks/truth.py --json`.

Fixed seeds; one JSON object on stdout, progress on stderr; `--only NAME` runs one part. Each part is a function in a
module of its own, with its size as a parameter.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

from truth_ccd import ccd_truth
from truth_distance import distance_truth
from truth_pairs import pairs_truth
from truth_scenes import scenes_truth
from truth_spheres import spheres_truth
from truth_triangles import tri_tri_truth

PARTS: dict[str, Callable[[], dict[str, object]]] = {
    "scenes": scenes_truth,
    "distance": distance_truth,
    "tri_tri": tri_tri_truth,
    "spheres": spheres_truth,
    "ccd": ccd_truth,
    "pairs": pairs_truth,
}
"""The longest first: they share the processes."""


def run_part(name: str) -> tuple[dict[str, object], float]:
    """What one part finds, and the seconds that it took."""
    start = time.perf_counter()
    found = PARTS[name]()
    return found, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument("--only", choices=PARTS, action="append", help="run this part alone; may be repeated")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="parts that run at the same time")
    chosen = parser.parse_args()
    names = [name for name in PARTS if name in (chosen.only or PARTS)]
    results: dict[str, object] = {}
    with ProcessPoolExecutor(max_workers=max(1, chosen.jobs)) as pool:
        running = {name: pool.submit(run_part, name) for name in names}
        print(f"running {', '.join(names)}", file=sys.stderr, flush=True)
        for name in names:
            found, seconds = running[name].result()
            results |= found
            print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
    print(json.dumps(results, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
