"""The lattice at rest: its springs, masses, anchors and cells; stiffness of bars and plates; folds."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse.linalg as spl
from numpy.typing import NDArray

from cadsculpt.errors import InputError
from cadsculpt.physics.calibrate import OFFSETS
from cadsculpt.physics.lattice import Lattice, build_lattice, hexahedra, spring_segments
from cadsculpt.physics.material import Material

Array = NDArray[np.float64]


def tube(nu: int, nv: int, layers: int, radius: float, thickness: float, **options: Any) -> Lattice:
    """A tube along z, closed around u, pressed inward (towards its axis)."""
    angle = 2 * math.pi * np.arange(nu) / nu
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)[:, None, :] * np.ones((1, nv, 1))
    points = radius * out
    points[..., 2] = np.arange(nv) * 2 * math.pi * radius / nu
    return build_lattice(
        points,
        -out,
        angle,
        np.arange(nv, dtype=float),
        thickness=thickness,
        layers=layers,
        material=Material(1e6, 1000.0, damping=0.0),
        wrap=(True, False),
        period=(2 * math.pi, 0.0),
        metres_per_unit=1e-3,
        **options,
    )


@pytest.mark.parametrize("wrap", [(False, False), (True, False), (False, True), (True, True)])
@pytest.mark.parametrize("shape", [(3, 3, 2), (5, 4, 3), (40, 30, 3), (4, 300, 2)])
def test_segments_are_exactly_the_springs(shape: tuple[int, int, int], wrap: tuple[bool, bool]) -> None:
    """Every spring that the offsets give appears once, whatever the chunks, and nothing reaches beyond one node
    outside.
    """
    nu, nv, nl = shape
    count = nu * nv * nl
    i, j, k = np.unravel_index(np.arange(count), shape)
    found = set()
    for d, start, stop, shift in spring_segments(shape, wrap):
        assert 0 <= start < stop <= count
        assert start + shift >= -1
        assert stop + shift <= count + 1
        found.update((int(d), n, n + int(shift)) for n in range(start, stop))
    wanted = set()
    for d, (di, dj, dk) in enumerate(OFFSETS):
        a, b, c = i + di, j + dj, k + dk
        exists = (c >= 0) & (c < nl)
        for axis, t, n in ((0, a, nu), (1, b, nv)):
            exists &= wrap[axis] | ((t >= 0) & (t < n))
        ends = ((a % nu) * nv + b % nv) * nl + c
        wanted.update((d, int(n), int(ends[n])) for n in np.flatnonzero(exists))
    assert wanted <= found
    # what is found beyond that are runs across the ends of rows, which have no stiffness
    by_start = {}
    for d, n, end in found:
        assert by_start.setdefault((d, n), end) == end


def test_rest_lengths_and_masses(slab: Callable[..., Lattice], springs: Any) -> None:
    rng = np.random.default_rng(1)
    lattice = slab(6, 5, 3, move=lambda p: p + 0.2 * rng.uniform(-1, 1, p.shape))
    s = springs(lattice)
    lengths = np.linalg.norm(lattice.nodes[s.end] - lattice.nodes[s.start], axis=1)
    assert lattice.rest_length[s.direction, s.start] == pytest.approx(lengths, rel=1e-14)
    assert (lattice.rest_length[lattice.stiffness == 0.0] == 0.0).all()
    cells = hexahedra(lattice)
    assert len(cells) == 5 * 4 * 3
    assert lattice.mass.sum() == pytest.approx(1000.0 * lattice.volume.sum() * 1e-12, rel=1e-12)
    # 1 N moves 1 kg by 1 m/s^2, that is 1000 mm/s^2: m_eff = kg * metres_per_unit
    assert slab(2, 2, 1).mass.sum() == pytest.approx(1000.0 * 1e-9 * 1e-3, rel=1e-12)


def test_damping_does_not_depend_on_the_spacing(slab: Callable[..., Lattice]) -> None:
    material = Material(1e6, 1000.0, damping=0.3)
    rates = []
    for layers in (1, 2, 6):
        lattice = slab(3, 3, layers, steps=(3 / layers, 3 / layers, 3 / layers), material=material)
        rates.append(lattice.gamma / lattice.mass)
    # 2 * damping * (pi / 2) sqrt(1.2 E / density) / thickness
    expected = 0.3 * math.pi * math.sqrt(1.2e6 / 1000.0) / 3e-3
    assert np.concatenate(rates) == pytest.approx(expected, rel=1e-12)


def test_the_same_part_in_other_units(slab: Callable[..., Lattice]) -> None:
    """Millimetres and inches give the same frequencies and the same N per metre."""
    mm = slab(4, 4, 2)
    x, y = np.meshgrid(np.arange(4) / 25.4, np.arange(4) / 25.4, indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)
    inch = build_lattice(
        points,
        np.broadcast_to([0.0, 0.0, -1.0], points.shape),
        np.arange(4.0),
        np.arange(4.0),
        thickness=2 / 25.4,
        layers=2,
        material=Material(1e6, 1000.0, damping=0.0),
        metres_per_unit=0.0254,
    )
    assert inch.stiffness / 0.0254 == pytest.approx(mm.stiffness / 0.001, rel=1e-6, abs=1e-6)
    assert inch.mass / 0.0254 == pytest.approx(mm.mass / 0.001, rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    "steps", [(1, 1, 1), (0.5, 0.5, 0.5), (1, 1, 1.5), (1, 2, 1), (1, 3, 1), (3, 1, 1), (1, 1, 3), (3, 3, 1)]
)
def test_bar_in_tension(
    slab: Callable[..., Lattice], tangent: Any, steps: tuple[float, float, float], axis: int
) -> None:
    """Stress over strain of a free bar is Young's modulus, along every axis, also for cells of 1:3."""
    lattice = slab(5, 4, 3, steps=steps)
    index = np.stack(np.unravel_index(np.arange(len(lattice.nodes)), lattice.shape), axis=1)
    ends = np.array(lattice.shape) - 1
    share = np.ones(len(index))
    for other in {0, 1, 2} - {axis}:
        share *= np.where((index[:, other] == 0) | (index[:, other] == ends[other]), 0.5, 1.0)
    force = np.zeros_like(lattice.nodes)
    sign = -1.0 if axis == 2 else 1.0
    for at, direction in ((0, -sign), (ends[axis], sign)):
        face = index[:, axis] == at
        force[face, axis] += direction * share[face] / share[face].sum()
    # a free body: the six rigid motions are in the null space
    matrix = tangent(lattice).toarray()
    moved = (np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) @ force.ravel()).reshape(-1, 3)[:, axis]
    length = ends[axis] * steps[axis]
    strain = sign * (moved[index[:, axis] == ends[axis]].mean() - moved[index[:, axis] == 0].mean()) / length
    area = math.prod(float(ends[a] * steps[a]) for a in (0, 1, 2) if a != axis)
    modulus = 1.0 / area / strain
    assert modulus == pytest.approx(1.0, rel=0.01)  # E = 1e6 Pa = 1 N/mm^2
    lateral = np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) @ force.ravel()
    assert np.abs(matrix @ lateral - force.ravel()).max() < 1e-9


@pytest.mark.parametrize("twist", [0.05, 0.15, 0.25])
def test_bar_of_distorted_cells(slab: Callable[..., Lattice], tangent: Any, twist: float) -> None:
    rng = np.random.default_rng(7)

    def move(points: Array) -> Array:
        moved = points.copy()
        moved[1:-1, 1:-1] += twist * rng.uniform(-1, 1, moved[1:-1, 1:-1].shape) * np.array([1.0, 1.0, 0.0])
        return moved

    lattice = slab(13, 5, 4, move=move)
    index = np.stack(np.unravel_index(np.arange(len(lattice.nodes)), lattice.shape), axis=1)
    share = np.where((index[:, 1] % 4 == 0), 0.5, 1.0) * np.where((index[:, 2] % 4 == 0), 0.5, 1.0) / 16.0
    force = np.zeros_like(lattice.nodes)
    force[:, 0] = share * ((index[:, 0] == 12).astype(float) - (index[:, 0] == 0))
    matrix = tangent(lattice).tolil()
    held = [0, 1, 2, 3 * 4 + 1, 3 * (4 * 5) + 2, 3 * 4 + 2]  # six numbers that stop the rigid motions of a slab
    free = np.setdiff1d(np.arange(force.size), held)
    moved = np.zeros(force.size)
    moved[free] = spl.spsolve(matrix.tocsc()[free][:, free], 16.0 * force.ravel()[free])
    x = moved.reshape(-1, 3)[:, 0]
    strain = (x[index[:, 0] == 10].mean() - x[index[:, 0] == 2].mean()) / 8.0
    assert 1.0 / strain == pytest.approx(1.0, rel=0.05)


def clamped_plate(slab: Callable[..., Lattice], tangent: Any, layers: int) -> float:
    """Deflection of a clamped square plate, 30 thicknesses wide, under uniform pressure, over Timoshenko's 0.00126 q
    a^4 / D.
    """
    half = 15.0
    cells = round(half * layers / 3)
    lattice = slab(cells + 1, cells + 1, layers, steps=(half / cells, half / cells, 1.0 / layers))
    nu, nv, nl = lattice.shape
    i, j, _ = np.unravel_index(np.arange(nu * nv * nl), lattice.shape)
    held = np.zeros((nu * nv * nl, 3), dtype=bool)
    held[(i == nu - 1) | (j == nv - 1)] = True
    held[i == 0, 0] = True  # a quarter of the plate: its middle planes
    held[j == 0, 1] = True
    area = np.full((nu, nv), (half / cells) ** 2)
    area[[0, -1]] /= 2
    area[:, [0, -1]] /= 2
    force = np.zeros((nu, nv, nl, 3))
    force[:, :, 0, 2] = -area
    free = np.flatnonzero(~held.ravel())
    moved = np.zeros(held.size)
    moved[free] = spl.spsolve(tangent(lattice)[free][:, free], force.ravel()[free])
    rigidity = 1.0 / 12.0 / (1.0 - 0.25**2)
    return float(-moved.reshape(nu, nv, nl, 3)[0, 0, -1, 2] / (0.00126 * 30.0**4 / rigidity))


def test_clamped_plate_converges_with_layers(slab: Callable[..., Lattice], tangent: Any) -> None:
    errors = [abs(clamped_plate(slab, tangent, layers) - 1.0) for layers in (1, 2, 3, 4)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] <= 0.10


def test_hexahedra_are_positive_whichever_way_the_surface_runs(slab: Callable[..., Lattice]) -> None:
    for swap in (False, True):
        lattice = slab(3, 4, 2, move=lambda p, swap=swap: p[..., [1, 0, 2]] if swap else p)
        assert lattice.right_handed is swap
        corners = lattice.nodes[hexahedra(lattice)]
        e1, e2, e3 = (corners[:, n] - corners[:, 0] for n in (1, 3, 4))
        assert (np.einsum("ij,ij->i", np.cross(e1, e2), e3) > 0).all()
        assert len(np.unique(np.sort(hexahedra(lattice), axis=1), axis=0)) == 2 * 3 * 2


def test_holes_have_no_mass(slab: Callable[..., Lattice]) -> None:
    columns = np.ones((5, 5), dtype=bool)
    columns[1:4, 1:4] = False
    lattice = slab(6, 6, 2, cell_active=columns)
    active = lattice.active.reshape(6, 6, 3)
    assert not active[2:4, 2:4].any()
    assert active.sum() == (36 - 4) * 3
    assert (lattice.inverse_mass[~lattice.active] == 0.0).all()
    assert lattice.volume.sum() == pytest.approx(2.0 * (25 - 9))
    assert (lattice.stiffness[:, ~lattice.active] == 0.0).all()


def test_zones_of_two_materials(slab: Callable[..., Lattice]) -> None:
    soft, hard = Material(1e6, 1000.0, yield_strain=0.01), Material(4e6, 3000.0)
    which = np.zeros((4, 4), dtype=np.int64)
    which[2:] = 1
    lattice = slab(5, 5, 2, material=[soft, hard], cell_material=which)
    mass = (lattice.mass / lattice.volume).reshape(5, 5, 3)[:, 2, 1] * 1e12
    assert mass == pytest.approx([1000, 1000, 2000, 3000, 3000])
    edge = lattice.stiffness[1].reshape(5, 5, 3)[:, 2, 1]  # along v, inside
    assert edge[1:4] == pytest.approx([0.4, 0.5 * (0.4 + 1.6), 1.6], rel=1e-6)
    limit = lattice.yield_strain[1].reshape(5, 5, 3)[:, 2, 1]
    assert limit[:3] == pytest.approx(0.005)  # a shared spring yields as the weaker side does
    assert np.isinf(limit[3:]).all()


def test_closed_direction(springs: Any) -> None:
    lattice = tube(24, 5, 3, 10.0, 3.0)
    s = springs(lattice)
    per_node = np.bincount(np.concatenate([s.start, s.end]), minlength=len(lattice.nodes)).reshape(lattice.shape)
    assert (per_node == per_node[:1]).all()
    # turning by one step maps the lattice onto itself
    for field in (lattice.stiffness, lattice.rest_length):
        around = field.reshape(13, *lattice.shape)
        assert around == pytest.approx(np.broadcast_to(around[:, :1], around.shape), rel=1e-5, abs=1e-12)
    assert lattice.mass.reshape(lattice.shape) == pytest.approx(
        np.broadcast_to(lattice.mass.reshape(lattice.shape)[:1], lattice.shape), rel=1e-9
    )
    # the volume of a 24-sided tube
    polygon = 12 * math.sin(2 * math.pi / 24)
    assert lattice.volume.sum() == pytest.approx(polygon * (100 - 49) * 4 * 2 * math.pi * 10 / 24, rel=1e-9)


def test_a_pole_is_tied_together() -> None:
    """All nodes of a row in one point, as on a sphere: they stay one point and the lattice is sound."""
    u = np.linspace(0, 2 * math.pi, 12, endpoint=False)
    v = np.linspace(0, 0.5 * math.pi, 6)
    out = np.stack(
        [
            np.cos(u)[:, None] * np.sin(v),
            np.sin(u)[:, None] * np.sin(v),
            np.ones_like(u)[:, None] * np.cos(v),
        ],
        axis=-1,
    )
    lattice = build_lattice(
        10 * out,
        -out,
        u,
        v,
        thickness=2.0,
        layers=2,
        material=Material(1e6, 1000.0, yield_strain=0.01),
        wrap=(True, False),
        period=(2 * math.pi, 0.0),
        metres_per_unit=1e-3,
    )
    ring = lattice.stiffness[0].reshape(lattice.shape)[:, 0]
    assert (ring > 0.0).all()
    assert np.isinf(lattice.yield_strain[0].reshape(lattice.shape)[:, 0]).all()
    assert (lattice.mass > 0.0).all()


def test_a_lattice_that_folds_says_where_and_what_would_do() -> None:
    with pytest.raises(InputError, match=r"at u = .*folds") as caught:
        tube(24, 5, 3, 10.0, 10.5)
    thickness = float(re.search(r"thickness of ([\d.]+) or less", str(caught.value)).group(1))  # type: ignore[union-attr]
    # the tube's radius, less the two hundredths that every cell must keep
    assert thickness == pytest.approx(10.0, rel=0.05)
    assert thickness < 10.0
    tube(24, 5, 3, 10.0, thickness)


def test_the_fold_is_found_where_the_curvature_is() -> None:
    """A valley of radius 2 at u = 3 pressed from inside: only there does a thickness of 2.5 fold."""
    x = np.linspace(-6, 6, 49)
    z = np.where(np.abs(x) < 2, -np.sqrt(np.maximum(0.0, 4 - np.minimum(x**2, 4))), 0.0) * 0.999
    y = np.arange(3.0)
    points = np.stack(np.broadcast_arrays(x[:, None], y, z[:, None]), axis=-1)
    tangent = np.gradient(points[:, 0], axis=0)
    normal = np.stack([-tangent[:, 2], 0 * x, tangent[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    with pytest.raises(InputError) as caught:
        build_lattice(
            points,
            np.broadcast_to(normal[:, None], points.shape),
            x,
            y,
            thickness=2.5,
            layers=2,
            material=Material(1e6, 1000.0),
            metres_per_unit=1e-3,
        )
    where = float(re.search(r"u = (-?[\d.e-]+)", str(caught.value)).group(1))  # type: ignore[union-attr]
    assert abs(where) < 2.1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"thickness": 0.0}, "thickness is 0"),
        ({"thickness": math.nan}, "thickness is nan"),
        ({"layers": 0}, "0 layers"),
        ({"metres_per_unit": -1.0}, "metres_per_unit"),
        ({"u": [0.0, 2.0, 1.0]}, "along u do not increase"),
        ({"u": [0.0, 1.0]}, "do not belong"),
        ({"wrap": (True, False)}, "u is closed and its period is 0"),
        ({"anchored": np.zeros((3, 3, 3), dtype=bool)}, "anchored is"),
        ({"cell_active": np.zeros((2, 2), dtype=bool)}, "no cell"),
        ({"material": [], "cell_material": np.zeros((2, 2), dtype=int)}, "materials"),
        ({"cell_material": np.ones((2, 2), dtype=int)}, "materials beyond the 1"),
    ],
)
def test_bad_input_is_named(change: dict[str, Any], words: str) -> None:
    x, y = np.meshgrid(np.arange(3.0), np.arange(3.0), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)
    given: dict[str, Any] = {
        "u": np.arange(3.0),
        "v": np.arange(3.0),
        "thickness": 1.0,
        "layers": 1,
        "material": Material(1e6, 1000.0),
        "metres_per_unit": 1e-3,
    }
    with pytest.raises(InputError, match=words):
        build_lattice(points, np.broadcast_to([0.0, 0.0, -1.0], points.shape), **{**given, **change})


def test_a_surface_that_turns_over_is_refused() -> None:
    x, y = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)
    points[2, 1, 0] = 0.5
    with pytest.raises(InputError, match="turns over"):
        build_lattice(
            points,
            np.broadcast_to([0.0, 0.0, -1.0], points.shape),
            np.arange(4.0),
            np.arange(4.0),
            thickness=1.0,
            layers=1,
            material=Material(1e6, 1000.0),
            metres_per_unit=1e-3,
        )
