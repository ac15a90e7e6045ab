"""Materials: the numbers they accept, and presets that are in a handbook's range."""

from __future__ import annotations

import math

import pytest

from cadsculpt.errors import InputError
from cadsculpt.physics.material import PRESETS, Material


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("youngs_modulus", 0.0),
        ("youngs_modulus", -1.0),
        ("youngs_modulus", math.nan),
        ("youngs_modulus", math.inf),
        ("density", 0.0),
        ("density", math.nan),
        ("damping", -0.1),
        ("damping", math.inf),
        ("yield_strain", 0.0),
        ("yield_strain", math.nan),
        ("hardening", -0.1),
        ("hardening", 1.1),
        ("friction", -1.0),
        ("friction", math.nan),
    ],
)
def test_bad_numbers_are_refused_by_name(field: str, value: float) -> None:
    good = {"youngs_modulus": 1e6, "density": 1000.0}
    with pytest.raises(InputError, match=f"material 'putty': {field}"):
        Material(**{**good, field: value}, name="putty")


def test_presets() -> None:
    assert set(PRESETS) == {"clay", "foam", "rubber", "flesh", "sheet steel", "aluminium"}
    for name, material in PRESETS.items():
        assert material.name == name
    # the speed of sound in a thin bar, sqrt(E / density), of handbooks: steel 5.2 km/s, aluminium 5.1 km/s, rubber 50
    # m/s
    speed = {name: math.sqrt(m.youngs_modulus / m.density) for name, m in PRESETS.items()}
    assert speed["sheet steel"] == pytest.approx(5170, rel=0.02)
    assert speed["aluminium"] == pytest.approx(5100, rel=0.02)
    assert 30 < speed["rubber"] < 70
    # yield stress: DC04 at most 210 MPa, EN AW-5754-O at least 80 MPa
    assert PRESETS["sheet steel"].youngs_modulus * PRESETS["sheet steel"].yield_strain <= 210e6
    assert PRESETS["aluminium"].youngs_modulus * PRESETS["aluminium"].yield_strain >= 80e6
    assert math.isinf(PRESETS["foam"].yield_strain)
    assert math.isinf(PRESETS["rubber"].yield_strain)
