"""Materials by the numbers that a handbook gives: modulus, density, damping, yield, friction."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import InputError


@dataclass(frozen=True, slots=True)
class Material:
    """An isotropic material of Poisson's ratio 1/4, the ratio that central springs can have.

    youngs_modulus : [Pa]. density : [kg/m3]. damping : fraction of critical, at the lowest thickness mode
    (lattice.py). yield_strain : strain at which a bar in tension starts to flow, math.inf for an elastic material.
    hardening : tangent modulus after yield over Young's modulus, 0 (none) to 1 (never yields). friction : Coulomb's
    mu against any tool.

    Raises InputError, naming the number, when one of them is not finite (yield_strain may be infinite), the modulus,
    density or yield strain not positive, damping, hardening or friction negative, or hardening above 1.
    """

    youngs_modulus: float
    density: float
    damping: float = 0.1
    yield_strain: float = math.inf
    hardening: float = 0.0
    friction: float = 0.0
    name: str = ""

    def __post_init__(self) -> None:
        where = f"material {self.name!r}" if self.name else "material"
        for field in ("youngs_modulus", "density", "yield_strain"):
            value = getattr(self, field)
            finite = math.isfinite(value) or (field == "yield_strain" and value == math.inf)
            if not (finite and value > 0.0):
                raise InputError(f"{field} is {value}", where=where, mend="it must be a positive number")
        for field in ("damping", "hardening", "friction"):
            value = getattr(self, field)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{field} is {value}", where=where, mend="it must be zero or a positive number")
        if self.hardening > 1.0:
            raise InputError(
                f"hardening is {self.hardening}", where=where, mend="it is a share of Young's modulus, from 0 to 1"
            )


PRESETS: dict[str, Material] = {
    "clay": Material(3.0e5, 1700.0, damping=0.3, yield_strain=0.03, hardening=0.1, friction=0.4, name="clay"),
    "foam": Material(1.0e5, 30.0, damping=0.2, friction=0.6, name="foam"),
    "rubber": Material(2.0e6, 930.0, damping=0.1, friction=0.8, name="rubber"),
    "flesh": Material(8.0e4, 1100.0, damping=0.3, friction=0.5, name="flesh"),
    "sheet steel": Material(
        2.1e11, 7850.0, damping=0.02, yield_strain=1.0e-3, hardening=5.0e-3, friction=0.12, name="sheet steel"
    ),
    "aluminium": Material(
        7.0e10, 2670.0, damping=0.02, yield_strain=1.2e-3, hardening=1.0e-2, friction=0.15, name="aluminium"
    ),
}
"""Materials to start from.

clay : wet modelling clay, softer than "very soft clay" (0.5 to 5 MPa: US Army Corps of Engineers, EM 1110-1-1904,
    table D-3); density of soft saturated clay (Terzaghi and Peck 1967, Soil Mechanics in Engineering Practice). It
    flows at 9 kPa, which a thumb can do.
foam : flexible open-cell polyurethane (Gibson and Ashby 1997, Cellular Solids, chapter 5).
rubber : natural rubber (Ashby 2011, Materials Selection in Mechanical Design, appendix A).
flesh : of a fingertip, its dermis (Maeno, Kobayashi, Yamazaki 1998, Relationship between the structure of human finger
    tissue and the location of tactile receptors, JSME Int. J. C 41).
sheet steel : deep-drawing steel DC04, which yields at 210 MPa at most (EN 10130); modulus and density of EN 1993-1-1;
    lubricated.
aluminium : EN AW-5754, annealed, which yields at 80 MPa at least (EN 485-2); modulus of EN 1999-1-1; lubricated.

Damping is that of a specimen held in a machine, not a property of the alloy: it brings a pressed part to rest.
"""
