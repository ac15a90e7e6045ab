"""The G and M codes that are read, by modal group, and those that are refused, with the reason and the mend."""

from __future__ import annotations

GROUPS: dict[str, tuple[float, ...]] = {
    "motion": (0, 1, 2, 3, 80),
    "plane": (17, 18, 19),
    "distance": (90, 91),
    "arc distance": (90.1, 91.1),
    "feed": (93, 94, 95),
    "unit": (20, 21),
    "compensation": (40, 41.1, 42.1),
    "length": (43, 43.1, 43.2, 43.4, 49),
    "coordinates": (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3),
    "path": (61, 61.1, 64),
    "retract": (98, 99),
    "spindle": (96, 97),
    "lathe": (8,),
    "once": (4, 10, 28, 28.1, 30, 30.1, 53, 92, 92.1, 92.2, 92.3),
}
GROUP: dict[float, str] = {code: group for group, codes in GROUPS.items() for code in codes}
REFUSED: dict[float, tuple[str, str]] = {
    7: ("lathe diameters", "write radii (G8)"),
    5: ("cubic splines", "write lines and arcs"),
    5.1: ("quadratic splines", "write lines and arcs"),
    5.2: ("NURBS", "write lines and arcs"),
    33: ("spindle-synchronised motion", "write the moves out"),
    33.1: ("rigid tapping", "write the moves out"),
    41: ("cutter compensation from a tool table", "write the tool's own path, or G41.1 with the diameter as D"),
    42: ("cutter compensation from a tool table", "write the tool's own path, or G42.1 with the diameter as D"),
    43.5: ("tool axes as vectors", "write the rotary axes"),
    52: ("local offsets", "use G92 or G10"),
    68: ("rotated coordinates", "write the moves out"),
    **{38.0 + k / 10: ("probing", "leave it out") for k in (2, 3, 4, 5)},
    **{float(k): ("a canned cycle", "write its moves out") for k in (*range(70, 80), *range(81, 90))},
}
FLOW: dict[float, str] = {
    98: "calls a program of another file",
    99: "goes back from a program",
    70: "saves modes",
    71: "saves modes",
    72: "restores modes",
    73: "saves modes",
}
