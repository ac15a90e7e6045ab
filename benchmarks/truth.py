"""What is claimed of the collision, shown true: `python benchmarks/truth.py --json`.

Fixed seeds; one JSON object on stdout, progress on stderr; `--only NAME` runs one part. Each part is a function in a
module of its own, with its size as a parameter.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

from truth_pairs import pairs_truth
from truth_scenes import scenes_truth
from truth_spheres import spheres_truth
from truth_triangles import tri_tri_truth

Part = Callable[[], dict[str, object]]

PARTS: dict[str, Part] = {
    "spheres": spheres_truth,
    "tri_tri": tri_tri_truth,
    "pairs": pairs_truth,
    "scenes": scenes_truth,
}

MISSING: list[str] = []

try:
    from truth_distance import distance_truth

    PARTS["distance"] = distance_truth
except ImportError:
    MISSING.append("distance")

try:
    from truth_ccd import ccd_truth

    PARTS["ccd"] = ccd_truth
except ImportError:
    MISSING.append("ccd")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument(
        "--only", choices=[*PARTS, *MISSING], action="append", help="run this part alone; may be repeated"
    )
    chosen = parser.parse_args()
    results: dict[str, object] = {}
    for name in chosen.only or [*PARTS, *MISSING]:
        if name in MISSING:
            print(f"{name}: NOT THERE, nothing was shown about it", file=sys.stderr)
            results[f"{name}_missing"] = True
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        start = time.perf_counter()
        results |= PARTS[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    print(json.dumps(results, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
