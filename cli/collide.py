"""`cadsculpt collide`: do two bodies touch, and how near are they?"""

from __future__ import annotations

from typing import Any

import click

from .console import ProgressDisplay, note, number, print_json, print_pairs, print_table, warn

SHOWN = 20
"""Contacts that the table shows; --json has all."""


@click.command("collide")
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--clearance", type=float, default=0.0, metavar="X", help="Smallest distance that is still clear, in mm; 0."
)
@click.option(
    "--tolerance", type=float, metavar="X", help="How well the distance is to be known, in mm; 1e-6 of the size."
)
@click.option("--touch", type=float, metavar="X", help="Distances below X count as touching, in mm; 1e-6 of the size.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else there.")
@click.option(
    "--units-a", metavar="U", help="Length unit of A, where its file names none or the wrong one: mm, in, ..."
)
@click.option("--units-b", metavar="U", help="The same for B.")
@click.option("--quiet", is_flag=True, help="No progress.")
def command(
    a: str,
    b: str,
    clearance: float,
    tolerance: float | None,
    touch: float | None,
    as_json: bool,
    units_a: str | None,
    units_b: str | None,
    quiet: bool,
) -> int:
    """Tell whether A and B touch, and bound the distance between them.

    A and B are CAD files (STEP, IGES, 3DM, patch JSON), single faces of them (FILE#face, by name or number), or meshes
    (STL, OBJ, PLY). The answer is about the true surfaces, not about a mesh of them: the distance lies in the interval
    printed, for certain.

    \b
    cadsculpt collide housing.step lid.step
    cadsculpt collide housing.step lid.step --clearance 0.5
    cadsculpt collide part.step#top part.step#3 --json

    Exit codes: 0 clear, 1 in contact or nearer than the clearance (or not decided), 2 bad input.
    """
    from ..collision import collide
    from ..formats.clash import body_named, clash_object
    from ..formats.compile_beside import compile_beside
    from ..warm import warm_collision_beside

    warnings: list[str] = []
    with ProgressDisplay(quiet=quiet) as progress:
        first, second = (
            body_named(text, units, lambda name: progress.update("reading", remark=name), warnings)
            for text, units in ((a, units_a), (b, units_b))
        )
        progress.update("colliding")
        remark = "first use on this machine: compiling the kernels, once"
        with compile_beside(warm_collision_beside, tell=lambda: progress.update("compiling", remark=remark)):
            result = collide(first.body, second.body, clearance=clearance, tolerance=tolerance, touch=touch)
    found = clash_object(result, first, second)
    if as_json:
        print_json(found)
    else:
        _print(found, (first.label, second.label))
    for line in warnings:
        warn(line)
    if found["verdict"] == "undecided":
        left = found["left_out"]
        given_up = "the search was given up (ask for a larger --touch, or another --clearance)"
        warn(f"undecided: {f'{len(left)} faces could not be looked at' if left else given_up}")
    return 0 if found["verdict"] == "clear" else 1


def _print(found: dict[str, Any], names: tuple[str, str]) -> None:
    low, high = found["distance"]
    print_pairs(
        [
            ("verdict", found["verdict"]),
            ("kind", _kind(found)),
            ("distance", number(low, "mm", 9) if low == high else f"{low:.9g} to {high:.9g} mm"),
            *([("clearance", number(found["clearance"], "mm", 9))] if found["clearance"] > 0 else []),
            ("contacts", str(len(found["contacts"]))),
        ]
    )
    rows = found["contacts"][:SHOWN]
    if rows:
        click.echo()
        columns = ("x", "y", "z", "depth mm", names[0], names[1])
        print_table(
            columns,
            [
                [*(f"{x:.6g}" for x in row["point"]), f"{row['depth']:.4g}", _place(row["a"]), _place(row["b"])]
                for row in rows
            ],
            right=columns[:4],
        )
        if len(found["contacts"]) > SHOWN:
            note(f"and {len(found['contacts']) - SHOWN} more (--json lists all)")


def _kind(found: dict[str, Any]) -> str:
    if found["verdict"] == "undecided":
        return "unknown"
    if found["kind"] != "clear":
        return str(found["kind"])
    return "apart" if found["verdict"] == "clear" else "apart, but nearer than the clearance"


def _place(side: dict[str, Any]) -> str:
    if side["face"] is None:
        return "-"
    return f"{side['face']} ({side['u']:.5g}, {side['v']:.5g})"
