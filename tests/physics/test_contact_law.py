"""The contact law of a face: by the material under the contact, by both materials, and by what may be left."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cadsculpt.physics.contact_law import ContactLaw, contact_numbers
from cadsculpt.physics.forces import contact_stiffness
from cadsculpt.physics.lattice import build_lattice
from cadsculpt.physics.material import PRESETS, Material

SOFT, HARD = Material(1e5, 100.0, friction=0.7), Material(1e7, 1000.0, friction=0.2)


def law(materials=(SOFT, HARD), penetration=math.inf, wrap=False) -> ContactLaw:
    """A plate of 8 x 4 cells, the second half along u of the second material."""
    u, v = np.arange(8.0 if wrap else 9.0), np.arange(5.0)
    points = np.stack([*np.meshgrid(u, v, indexing="ij"), np.zeros((len(u), 5))], axis=-1)
    if wrap:
        angle = 2 * np.pi * u / 8
        points = np.stack(
            [*(np.broadcast_to(5 * f(angle)[:, None], (8, 5)) for f in (np.cos, np.sin)), points[..., 1]], -1
        )
        inward = -points * [1, 1, 0] / 5
    else:
        inward = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    kinds = np.repeat(np.arange(8)[:, None] // 4, 4, axis=1)
    lattice = build_lattice(
        points, inward, u, v, thickness=2.0, layers=2, material=list(materials), cell_material=kinds,
        wrap=(wrap, False), period=(8.0, 0.0) if wrap else None, metres_per_unit=1e-3,
    )  # fmt: skip
    return ContactLaw(lattice, tuple(materials), 1.0, penetration)


@pytest.mark.parametrize("wrap", [False, True])
def test_a_contact_is_of_the_material_under_it(wrap):
    u = np.array([0.0, 1.5, 3.99, 4.01, 7.9])
    np.testing.assert_array_equal(law(wrap=wrap).kinds(u, np.full(5, 2.0)), [0, 0, 0, 1, 1])
    if wrap:
        np.testing.assert_array_equal(law(wrap=True).kinds(np.array([8.2, -0.2]), np.full(2, 1.0)), [0, 1])
    for i, material in enumerate((SOFT, HARD)):
        stiffness, damping, friction = contact_numbers(law(), i)
        assert stiffness == contact_stiffness(material, 2.0, 1.0, 1e-3)
        assert friction == material.friction
        # half of critical for the contact's own spring under half a cell's mass
        mass = 0.5 * material.density * 1e-3 * law().lattice.spacing * 1e-3**3
        assert damping == pytest.approx(math.sqrt(stiffness * mass))


def test_two_materials_stand_one_behind_the_other():
    first, second = law(), law()
    k, c, mu = contact_numbers(first, 0, second, 1)
    (k0, c0, _), (k1, c1, _) = contact_numbers(first, 0), contact_numbers(second, 1)
    assert 1 / k == pytest.approx(1 / k0 + 1 / k1)
    assert (k / c**2) == pytest.approx(k0 / c0**2 + k1 / c1**2)
    assert mu == 0.2
    assert contact_numbers(second, 1, first, 0) == pytest.approx((k, c, mu))


def test_it_is_as_stiff_as_max_penetration_asks_for():
    coarse, fine = contact_numbers(law(penetration=1.0), 0)[0], contact_numbers(law(penetration=1e-5), 0)[0]
    assert coarse == contact_numbers(law(), 0)[0]
    # 0.3 E is as much as can press
    assert fine * 1e-5 == pytest.approx(0.3 * SOFT.youngs_modulus * 1e-6)
    metal = PRESETS["aluminium"]
    k = contact_numbers(law((metal, metal), penetration=1e-6), 0)[0]
    assert k * 1e-6 == pytest.approx((3 * metal.yield_strain + 0.3 * metal.hardening) * metal.youngs_modulus * 1e-6)
