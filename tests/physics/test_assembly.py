"""Several lattices as one: the same bytes as alone, parts that do not feel each other, readers of one part, bad input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cadsculpt.errors import InputError
from cadsculpt.physics.assembly import assemble
from cadsculpt.physics.explicit import ContactLoad, LatticeState, StepForces, advance, stable_substep
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.implicit import advance_implicit
from cadsculpt.physics.lattice import Lattice, hexahedra
from cadsculpt.physics.material import PRESETS, Material
from cadsculpt.physics.measures import elastic_energy, kinetic_energy, nodal_strain, nodal_stress

Array = NDArray[np.float64]
Step = Callable[..., StepForces]

FIELDS = ("x", "velocity", "rest_length")


def load_on(contact: Callable[..., ContactLoad], lattice: Lattice) -> ContactLoad:
    nodes, weights = node_weights(lattice, [1.2, 2.6, 1.9], [0.7, 2.1, 1.4])
    return contact(nodes, weights, depth=0.05, stiffness=10.0, damping=1e-4, friction=0.3, velocity=(2.0, 0.0, -4.0))


def shifted(load: ContactLoad, by: int) -> ContactLoad:
    return replace(load, nodes=load.nodes + by)


@pytest.mark.parametrize("step", [advance, advance_implicit])
def test_an_assembly_of_one_part_is_that_part(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], step: Step
) -> None:
    lattice = slab(5, 5, 2, base=True, material=PRESETS["clay"])
    assembly = assemble([lattice])
    assert assembly.lattice is lattice
    assert assembly.starts == (0,)
    alone, together = LatticeState.at_rest(lattice), LatticeState.at_rest(assembly.lattice)
    for state, of in ((alone, lattice), (together, assembly.lattice)):
        step(of, state, load_on(contact, lattice), 1e-3)
    for name in FIELDS:
        assert getattr(alone, name).tobytes() == getattr(together, name).tobytes()


def three(slab: Callable[..., Lattice]) -> list[Lattice]:
    """Parts that lie in each other's way, without contact: their borders in the arrays must not be springs."""
    return [
        slab(5, 5, 2, base=True, material=PRESETS["clay"]),
        slab(4, 6, 3, base=True, steps=(1.1, 0.9, 0.8), material=Material(1e6, 1000.0, damping=0.1)),
        slab(5, 4, 1, base=True, material=PRESETS["clay"]),
    ]


def test_parts_do_not_feel_each_other(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """Explicit, the same sub-step: the very bytes that each part has alone."""
    parts = three(slab)
    assembly = assemble(parts)
    substep = 0.5 * min(stable_substep(part) for part in parts)
    whole = LatticeState.at_rest(assembly.lattice)
    states = [LatticeState.at_rest(part) for part in parts]
    rng = np.random.default_rng(0)
    for k, state in enumerate(states):
        state.velocity[parts[k].inverse_mass > 0] = rng.normal(size=3)
        assembly.part_state(whole, k).velocity[:] = state.velocity
    for _ in range(3):
        result = advance(
            assembly.lattice, whole, shifted(load_on(contact, parts[1]), assembly.starts[1]), 2e-3, substep=substep
        )
        for k, (part, state) in enumerate(zip(parts, states, strict=True)):
            alone = advance(part, state, load_on(contact, part) if k == 1 else None, 2e-3, substep=substep)
            assert alone.substeps == result.substeps
            for name in FIELDS:
                assert getattr(assembly.part_state(whole, k), name).tobytes() == getattr(state, name).tobytes()
            if k == 1:
                assert alone.mean_force.tobytes() == result.mean_force.tobytes()


@pytest.mark.parametrize("quasi_static", [False, True])
def test_parts_do_not_feel_each_other_in_implicit_steps(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], quasi_static: bool
) -> None:
    parts = three(slab)
    assembly = assemble(parts)
    whole = LatticeState.at_rest(assembly.lattice)
    loads = [shifted(load_on(contact, parts[k]), assembly.starts[k]) for k in (0, 2)]
    both = replace(
        loads[0],
        **{
            f: np.concatenate([getattr(load, f) for load in loads])
            for f in ContactLoad.__slots__
            if not f.startswith("other")
        },
    )
    advance_implicit(assembly.lattice, whole, both, 1e-2, quasi_static=quasi_static)
    for k, part in enumerate(parts):
        state = LatticeState.at_rest(part)
        advance_implicit(part, state, load_on(contact, part) if k != 1 else None, 1e-2, quasi_static=quasi_static)
        mine = assembly.part_state(whole, k)
        moved = np.abs(state.x - part.nodes).max()
        assert (moved > 1e-2) == (k != 1)
        assert mine.x == pytest.approx(state.x, abs=1e-4 * moved + 1e-12)


def test_what_reads_one_lattice_reads_a_part(slab: Callable[..., Lattice]) -> None:
    parts = three(slab)
    assembly = assemble(parts)
    whole = LatticeState.at_rest(assembly.lattice)
    whole.x += 0.05 * np.random.default_rng(1).normal(size=whole.x.shape)
    whole.velocity += 1.0
    for measure in (elastic_energy, kinetic_energy):
        shares = [measure(part, assembly.part_state(whole, k)) for k, part in enumerate(parts)]
        assert sum(shares) == pytest.approx(measure(assembly.lattice, whole), rel=1e-12)
    for nodal in (nodal_strain, nodal_stress):
        found = np.concatenate([nodal(part, assembly.part_state(whole, k)) for k, part in enumerate(parts)])
        assert found == pytest.approx(nodal(assembly.lattice, whole), rel=1e-12)
    assembly.part_state(whole, 1).x[3] = 7.0
    assert (whole.x[assembly.starts[1] + 3] == 7.0).all()
    with pytest.raises(InputError, match="has no grid"):
        node_weights(assembly.lattice, [0.0], [0.0])
    with pytest.raises(InputError, match="has no grid"):
        hexahedra(assembly.lattice)


def test_the_bound_is_that_of_the_stiffest_part(slab: Callable[..., Lattice]) -> None:
    parts = three(slab)
    assert assemble(parts).lattice.highest_frequency == max(part.highest_frequency for part in parts)


def test_what_nothing_holds_is_free(slab: Callable[..., Lattice]) -> None:
    assembly = assemble([slab(3, 3, 1), slab(3, 3, 1, base=True), slab(4, 3, 1)])
    assert assembly.lattice.free.tolist() == [[0, 0, 18], [2, 36, 60]]


def test_bad_assemblies_are_named(slab: Callable[..., Lattice]) -> None:
    part = slab(3, 3, 1)
    with pytest.raises(InputError, match="no lattice"):
        assemble([])
    with pytest.raises(InputError, match=r"different units: 0\.001 m, 1 m"):
        assemble([part, replace(part, metres_per_unit=1.0)])
    both = assemble([part, slab(3, 3, 1, base=True)]).lattice
    with pytest.raises(InputError, match="that nothing holds"):
        advance_implicit(both, LatticeState.at_rest(both), None, 1.0, quasi_static=True)
