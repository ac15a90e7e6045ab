"""The benchmark of the physics, run small: every figure below what it may be."""

from __future__ import annotations

import numpy as np
import pytest


def test_a_bar_stretches_as_hooke_says(part):
    result = part("physics_static").bar_truth(cells=3, length=12)
    assert result["bar_error"] <= 0.05
    assert result["bar_error_aspect3"] <= 0.10


def test_a_clamped_plate_bends_as_timoshenko_says(part):
    errors = list(part("physics_static").plate_truth(layers=(1, 2, 3))["plate_error"].values())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] <= 0.10


def test_a_sphere_presses_as_hertz_says(part):
    force, layer = part("physics_static").hertz_force(per_radius=3)
    # free sides give way: less than an endless layer as thick
    assert force == pytest.approx(1.0, abs=0.10)
    assert force < layer


def test_bars_keep_their_set(part):
    result = part("physics_static").plastic_truth(cells=2, length=8)
    assert result["plastic_set_error"] <= 0.02
    assert result["plastic_load_error_solid"] <= 0.02
    # springs along the bar flow back a little on unloading
    assert result["plastic_set_error_solid"] <= 0.05


def test_an_oscillator_keeps_its_time(part):
    assert part("physics_motion").period_truth(periods=5)["period_error"] <= 0.001


def test_energy_without_damping_stays(part):
    result = part("physics_motion").energy_truth(steps=10_000, size=4)
    assert result["energy_drift"] <= 0.01
    assert result["energy_falls_implicit"]


def test_forces_balance(part):
    result = part("physics_motion").balance_truth()
    assert result["balance_error"] <= 1e-12
    assert result["balance_error_implicit"] <= 1e-6


def test_a_block_sticks_and_slips_at_mu(part):
    result = part("physics_motion").stick_slip_truth(bisections=7)
    assert result["stick_slip_error"] <= 0.02
    assert result["stick_slip_error_implicit"] <= 0.02


def test_the_force_does_not_depend_on_the_collision_resolution(part):
    changes = part("physics_scenes").resolution_truth(nodes=4.0)["force_resolution_change"]
    assert len(changes) == 3
    assert max(changes) <= 0.05


def test_explicit_and_implicit_leave_the_same_dent(part):
    result = part("physics_scenes").shape_truth(nodes=4.0, size=32.0)
    assert result["explicit_vs_implicit_final_shape"] <= 0.02
    assert result["explicit_vs_implicit_final_shape_quasi_static"] <= 0.02


def test_what_a_step_allocates_is_counted(part):
    result = part("physics_scenes").allocation_truth(warm=30, steps=1, nodes=4.0)
    assert result["array_bytes"] == 0
    assert result["zero_allocation"]
    assert 0 < result["object_bytes"] < 200_000
    memory = part("step_memory")
    assert memory.array_bytes(lambda: float(np.arange(100.0).sum() + np.ones(50).sum())) >= 800
