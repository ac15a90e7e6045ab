"""Is the length unit that a file names the one that its numbers are in?

Files with inch numbers that are labelled as mm are common, and so are files whose label a translator made up. Nobody can know,
so that a file is read as it says and a warning names what is likely: by the size of the part, by the tolerance that the
file states, and by the area that the sending system wrote beside the geometry.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..units import conversion

SMALLEST, LARGEST = 6.0, 10_000.0
"""mm; a part whose longest side lies outside is doubted."""

USUAL = (20.0, 3_000.0)
"""mm; between these lies the longest side of most parts."""

SHARPEST, BLUNTEST = 1e-6, 1.0
"""mm; a file's tolerance lies between these."""

SAME_AREA = 0.02
"""Relative difference within which two areas are the same."""

LIKELY = ("mm", "in", "cm", "m", "um", "mil")
"""Units that files are in, the most likely first."""


def unit_doubt(
    size: float, units: str, tolerance: float | None = None, areas: tuple[float, float] | None = None
) -> str:
    """What to say about the unit of a part, "" when there is no doubt.

    size : longest side of the part, mm, as read in `units`. tolerance : the file's, mm, as read. areas : of the geometry and
    of the file's own record of it, both in mm2 as the file's labels say.
    """
    if areas is not None and min(areas) > 0.0:
        told = _by_area(units, areas)
        if told:
            return (
                f"the file says that its area is {areas[1]:.4g} mm2, its geometry has {areas[0]:.4g} mm2: the lengths that it"
                f" labels {units} are likely {told}; {_mend(told)}"
            )
    if SMALLEST <= size <= LARGEST or not 0.0 < size < 1e50:
        return ""
    number = size * conversion("mm", units)
    guess = likely_unit(number, units, None if tolerance is None else tolerance * conversion("mm", units))
    length = f"{size:.3g} mm" if size < SMALLEST else f"{size / 1000.0:.3g} m"
    said = f"the part is {length} long if its numbers are in {units}, as the file says"
    return f"{said}; they are likely in {guess}: {_mend(guess)}" if guess else said


def likely_unit(number: float, units: str, tolerance: float | None = None) -> str:
    """The unit in which a longest side of `number` makes a part of usual size, "" when there is none.

    tolerance : the file's, a number in the same unit; units that would make it absurd come last.
    """
    fit = [u for u in LIKELY if u != units and USUAL[0] <= number * conversion(u, "mm") <= USUAL[1]]
    if tolerance is not None and tolerance > 0.0:
        fit.sort(key=lambda u: not SHARPEST <= tolerance * conversion(u, "mm") <= BLUNTEST)
    return fit[0] if fit else ""


def _by_area(units: str, areas: tuple[float, float]) -> str:
    """The unit that makes the geometry's area the recorded one, "" when none does or they agree as they are."""
    ratio = areas[1] / areas[0]
    if abs(ratio - 1.0) <= SAME_AREA:
        return ""
    found: Sequence[str] = [u for u in LIKELY if abs(ratio / conversion(u, units) ** 2 - 1.0) <= SAME_AREA]
    return found[0] if found else ""


def _mend(unit: str) -> str:
    return f"--units {unit} takes them so, file_units in a scene"
