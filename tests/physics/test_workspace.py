"""A step takes no memory once warm: neither for nodes nor for contacts, alone, in pairs, free and tied."""

from __future__ import annotations

import ast
import gc
import inspect
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from cadsculpt.physics import explicit, forces, impulses, rigid, springs, ties
from cadsculpt.physics.assembly import assemble
from cadsculpt.physics.explicit import ContactLoad, LatticeState, advance
from cadsculpt.physics.forces import node_weights
from cadsculpt.physics.lattice import Lattice
from cadsculpt.physics.material import PRESETS
from cadsculpt.physics.ties import Ties


def scenes(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]
) -> list[tuple[Lattice, ContactLoad, np.ndarray | None]]:
    lower, upper = slab(16, 16, 2, base=True, material=PRESETS["clay"]), slab(16, 16, 2, material=PRESETS["foam"])
    nodes, weights = node_weights(lower, np.linspace(1, 14, 1000), np.linspace(1, 14, 1000) ** 2 / 14)

    def load(**others: np.ndarray) -> ContactLoad:
        made = contact(
            nodes, weights, depth=0.02, area=0.1, stiffness=5.0, damping=1e-4, friction=0.4, velocity=(5.0, 0, -9.0)
        )
        return replace(made, **others) if others else made

    pair = assemble([lower, upper]).lattice
    tied = assemble([lower, upper], Ties(np.array([768]), np.array([[0, 3]]), np.array([[0.5, 0.5]]))).lattice
    frame = np.ones_like(pair.nodes)
    return [
        (lower, load(), None),
        (upper, load(), None),
        (pair, load(other_nodes=nodes + 768, other_weights=weights), frame),
        (tied, load(other_nodes=nodes + 768, other_weights=weights), None),
        (tied, load(), frame),
    ]


@pytest.mark.parametrize("which", range(5))
def test_a_warm_step_allocates_no_array(
    slab: Callable[..., Lattice], contact: Callable[..., ContactLoad], which: int
) -> None:
    """numpy reports its arrays to tracemalloc in a domain of its own."""
    lattice, load, frame = scenes(slab, contact)[which]
    state = LatticeState.at_rest(lattice)
    force = np.zeros_like(lattice.nodes)
    for _ in range(2):
        advance(lattice, state, load, 1e-4, external=force, frame_velocity=frame)
    gc.collect()
    tracemalloc.start(1)
    try:
        domain = tracemalloc.DomainFilter(True, np.lib.tracemalloc_domain)
        before = tracemalloc.take_snapshot().filter_traces([domain])
        tracemalloc.reset_peak()
        base = tracemalloc.get_traced_memory()[0]
        for _ in range(5):
            advance(lattice, state, load, 1e-4, external=force, frame_velocity=frame)
        peak = tracemalloc.get_traced_memory()[1] - base
        after = tracemalloc.take_snapshot().filter_traces([domain])
    finally:
        tracemalloc.stop()
    assert sum(trace.size for trace in after.traces) == sum(trace.size for trace in before.traces)
    # what is left are Python's own numbers and views: less than an array of as many numbers as there are nodes or contacts
    assert peak < 6000 < 8 * min(len(lattice.nodes), len(load.nodes))


@pytest.mark.parametrize("module", [explicit, forces, impulses, rigid, springs, ties])
def test_kernels_of_the_explicit_step_allocate_nothing(module: ModuleType) -> None:
    """No kernel of these modules makes an array: only views of what it is given."""
    makers = {
        "empty",
        "zeros",
        "ones",
        "full",
        "array",
        "copy",
        "empty_like",
        "zeros_like",
        "ascontiguousarray",
        "concatenate",
    }
    kernels = 0
    for function in ast.parse(inspect.getsource(module)).body:
        if isinstance(function, ast.FunctionDef) and any("njit" in ast.unparse(d) for d in function.decorator_list):
            kernels += 1
            calls = {
                node.func.attr
                for node in ast.walk(function)
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
            }
            assert not calls & makers, function.name
    assert kernels


def test_more_contacts_than_ever_find_room(slab: Callable[..., Lattice], contact: Callable[..., ContactLoad]) -> None:
    """The workspace grows; what a step gives does not depend on what it held before."""
    lattice = slab(6, 6, 2, base=True, material=PRESETS["clay"])
    fresh, used = LatticeState.at_rest(lattice), LatticeState.at_rest(lattice)
    for n in (5, 0, 40, 13):
        nodes, weights = node_weights(lattice, np.linspace(1, 4, n), np.linspace(1, 4, n))
        load = contact(nodes, weights, depth=0.02, area=0.1, stiffness=5.0, friction=0.4, velocity=(5.0, 0, -9.0))
        ends = [advance(lattice, state, load, 1e-4) for state in (fresh, used)]
        assert ends[0].mean_force.tobytes() == ends[1].mean_force.tobytes()
        assert ends[0].depth.tobytes() == ends[1].depth.tobytes()
        assert fresh.x.tobytes() == used.x.tobytes()
        assert len(used.workspace.depth) >= n
        fresh = used.copy()
