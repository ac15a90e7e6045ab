"""What is claimed of the physics, shown true against its formula: `python benchmarks/physics.py --json`.

One JSON object on stdout, progress on stderr; `--only NAME` runs one part. Each part is a function in a module of its own,
with its size as a parameter.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

from physics_motion import balance_truth, energy_truth, period_truth, stick_slip_truth
from physics_scenes import allocation_truth, penetration_truth, resolution_truth, shape_truth
from physics_static import bar_truth, hertz_truth, plastic_truth, plate_truth

PARTS: dict[str, Callable[[], dict[str, object]]] = {
    "bar": bar_truth,
    "plate": plate_truth,
    "hertz": hertz_truth,
    "period": period_truth,
    "energy": energy_truth,
    "balance": balance_truth,
    "plastic": plastic_truth,
    "stick_slip": stick_slip_truth,
    "resolution": resolution_truth,
    "shape": shape_truth,
    "penetration": penetration_truth,
    "allocation": allocation_truth,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, on one line")
    parser.add_argument("--only", choices=[*PARTS], action="append", help="run this part alone; may be repeated")
    chosen = parser.parse_args()
    results: dict[str, object] = {}
    for name in chosen.only or PARTS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        start = time.perf_counter()
        results |= PARTS[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    print(json.dumps(results, indent=None if chosen.json else 2))


if __name__ == "__main__":
    main()
