"""NumPy arrays to OCCT's array classes and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from OCP.collections import Array1_double, Array1_gp_Pnt, Array1_gp_Pnt2d, Array1_int, Array2_double, Array2_gp_Pnt
from OCP.gp import gp_Pnt, gp_Pnt2d

Array = NDArray[np.float64]


def reals(values: Array) -> Any:
    """Array1_double, from index 1."""
    out = Array1_double(1, len(values))
    for i, value in enumerate(values.tolist(), 1):
        out.SetValue(i, value)
    return out


def integers(values: NDArray[np.int64]) -> Any:
    """Array1_int, from index 1."""
    out = Array1_int(1, len(values))
    for i, value in enumerate(values.tolist(), 1):
        out.SetValue(i, value)
    return out


def points(values: Array) -> Any:
    """(n, 3) to Array1_gp_Pnt, from index 1."""
    out = Array1_gp_Pnt(1, len(values))
    for i, (x, y, z) in enumerate(values.tolist(), 1):
        out.SetValue(i, gp_Pnt(x, y, z))
    return out


def points_2d(values: Array) -> Any:
    """(n, 2) to Array1_gp_Pnt2d, from index 1."""
    out = Array1_gp_Pnt2d(1, len(values))
    for i, (x, y) in enumerate(values.tolist(), 1):
        out.SetValue(i, gp_Pnt2d(x, y))
    return out


def point_grid(values: Array) -> Any:
    """(r, s, 3) to Array2_gp_Pnt, from index 1, 1."""
    out = Array2_gp_Pnt(1, values.shape[0], 1, values.shape[1])
    for i, row in enumerate(values.tolist(), 1):
        for j, (x, y, z) in enumerate(row, 1):
            out.SetValue(i, j, gp_Pnt(x, y, z))
    return out


def real_grid(values: Array) -> Any:
    """(r, s) to Array2_double, from index 1, 1."""
    out = Array2_double(1, values.shape[0], 1, values.shape[1])
    for i, row in enumerate(values.tolist(), 1):
        for j, value in enumerate(row, 1):
            out.SetValue(i, j, value)
    return out


def from_reals(array: Any) -> Array:
    """Array1_double to (n,)."""
    return np.array(list(array), dtype=np.float64)


def from_integers(array: Any) -> NDArray[np.int64]:
    """Array1_int to (n,)."""
    return np.array(list(array), dtype=np.int64)


def from_points(array: Any) -> Array:
    """Array1_gp_Pnt to (n, 3)."""
    return np.array([(p.X(), p.Y(), p.Z()) for p in array], dtype=np.float64).reshape(-1, 3)


def from_points_2d(array: Any) -> Array:
    """Array1_gp_Pnt2d to (n, 2)."""
    return np.array([(p.X(), p.Y()) for p in array], dtype=np.float64).reshape(-1, 2)


def from_point_grid(array: Any) -> Array:
    """Array2_gp_Pnt to (r, s, 3)."""
    rows = range(array.LowerRow(), array.UpperRow() + 1)
    columns = range(array.LowerCol(), array.UpperCol() + 1)
    out = np.empty((len(rows), len(columns), 3))
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            p = array.Value(row, column)
            out[i, j] = p.X(), p.Y(), p.Z()
    return out


def from_real_grid(array: Any) -> Array:
    """Array2_double to (r, s)."""
    rows = range(array.LowerRow(), array.UpperRow() + 1)
    columns = range(array.LowerCol(), array.UpperCol() + 1)
    return np.array([[array.Value(i, j) for j in columns] for i in rows], dtype=np.float64)


def knots_and_multiplicities(knots: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distinct knots and how often each stands in a non-decreasing knot vector."""
    values, counts = np.unique(knots, return_counts=True)
    return values, counts.astype(np.int64)
