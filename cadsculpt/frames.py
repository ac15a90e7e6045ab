"""Frames: the sculpted patches on a display grid, with what acts on them, for pictures and series over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .physics.lattice import hexahedra
from .physics.measures import nodal_plastic_set, nodal_strain, nodal_stress
from .record import Frame, LatticeFrame, PatchFrame, ToolFrame
from .session import Session
from .tools.outline import outline

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_ROWS = 121
"""Rows and columns of a patch in a frame: enough for a picture, a thirtieth of the file that the full grid would make."""


@dataclass(frozen=True, slots=True, eq=False)
class _PatchView:
    """Rows and columns of a patch's grid that are shown, and the interpolation of nodes onto them."""

    rows: Index
    columns: Index
    rest: Array
    inside: NDArray[np.bool_] | None
    node_u: Array
    node_v: Array


@dataclass(slots=True, eq=False)
class FrameMaker:
    """Makes frames of a session; precomputes what does not change. `names` : of the patches, unlike each other."""

    session: Session
    names: tuple[str, ...]
    _views: list[_PatchView]
    _outlines: list[tuple[Array, Index]]

    @classmethod
    def of(cls, session: Session) -> FrameMaker:
        model = session.model
        views = []
        for patch in model.patches:
            matrices = patch.grid.matrices
            rows, columns = (
                np.unique(np.rint(np.linspace(0, n - 1, min(n, MOST_ROWS))).astype(np.int64)) for n in matrices.shape
            )
            rest = matrices.points(patch.surface.control_points, patch.surface.weights)[np.ix_(rows, columns)]
            inside = None if patch.grid.inside is None else patch.grid.inside[np.ix_(rows, columns)]
            views.append(
                _PatchView(
                    rows,
                    columns,
                    rest,
                    inside,
                    _interpolation(
                        patch.u, matrices.u[rows], wrap=patch.lattice.wrap[0], domain=patch.surface.domain[0]
                    ),
                    _interpolation(
                        patch.v, matrices.v[columns], wrap=patch.lattice.wrap[1], domain=patch.surface.domain[1]
                    ),
                )
            )
        several = len(model.bodies) > 1
        names = tuple(f"{model.bodies[p.body]}: {p.name}" if several else p.name for p in model.patches)
        return cls(session, names, views, [outline(tool.tool, scene_size=model.size) for tool in model.tools])

    def parameters(self) -> list[tuple[Array, Array]]:
        """Per patch the parameters u and v of the frames' rows and columns."""
        matrices = [patch.grid.matrices for patch in self.session.model.patches]
        return [(m.u[view.rows], m.v[view.columns]) for m, view in zip(matrices, self._views, strict=True)]

    def frame(self) -> Frame:
        """The session as it is now."""
        session, model, state = self.session, self.session.model, self.session.state
        pascal = model.metres_per_unit**-2
        patches = []
        for index, (patch, view) in enumerate(zip(model.patches, self._views, strict=True)):
            matrices = patch.grid.matrices
            points = matrices.points(state.control_points[index], patch.surface.weights)[
                np.ix_(view.rows, view.columns)
            ]
            pressure = np.zeros(view.rest.shape[:2])
            contact = np.zeros(view.rest.shape[:2], dtype=np.bool_)
            mine = np.flatnonzero((session.contacts.face == index) & (session.depths > 0))
            if len(mine):
                c = session.contacts
                i = _nearest(matrices.u[view.rows], c.u[mine])
                j = _nearest(matrices.v[view.columns], c.v[mine])
                push = -np.einsum("nc,nc->n", session.forces[mine], c.normal[mine]) / c.area[mine] * pascal
                np.maximum.at(pressure, (i, j), push)
                contact[i, j] = True
            stress = nodal_stress(patch.lattice, session.lattice(index))
            nu, nv, nl = patch.lattice.shape
            surface_stress = stress.reshape(nu, nv, nl)[:, :, 0]
            patches.append(
                PatchFrame(
                    self.names[index],
                    points,
                    points - view.rest,
                    pressure,
                    contact,
                    view.node_u @ surface_stress @ view.node_v.T,
                    view.inside,
                )
            )
        tools = tuple(
            ToolFrame(tool.name, pose.to_world(points), triangles)
            for tool, pose, (points, triangles) in zip(model.tools, state.poses, self._outlines, strict=True)
        )
        return Frame(state.step, state.time, tuple(patches), tools)

    def lattices(self) -> list[LatticeFrame]:
        """The hexahedra of every patch as they are now."""
        model = self.session.model
        return [
            LatticeFrame(
                name=self.names[i],
                nodes=self.session.lattice(i).x.copy(),
                hexahedra=hexahedra(patch.lattice),
                strain=nodal_strain(patch.lattice, self.session.lattice(i)),
                plastic=nodal_plastic_set(patch.lattice, self.session.lattice(i)),
                material=patch.lattice.cell_material.ravel(),
                active=patch.lattice.cell_material.ravel() != 1,  # 1 is the ghost beyond the trims
            )
            for i, patch in enumerate(model.patches)
        ]


def _interpolation(nodes: Array, t: Array, *, wrap: bool, domain: tuple[float, float]) -> Array:
    """Matrix (len(t), len(nodes)) of linear interpolation between node parameters, around the seam if closed."""
    ends = np.concatenate([nodes, [nodes[0] + domain[1] - domain[0]]]) if wrap else nodes
    i = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(ends) - 2)
    f = np.clip((t - ends[i]) / (ends[i + 1] - ends[i]), 0.0, 1.0)
    matrix = np.zeros((len(t), len(nodes)))
    rows = np.arange(len(t))
    np.add.at(matrix, (rows, i % len(nodes)), 1.0 - f)
    np.add.at(matrix, (rows, (i + 1) % len(nodes)), f)
    return matrix


def _nearest(grid: Array, t: Array) -> Index:
    middles = 0.5 * (grid[1:] + grid[:-1])
    return np.searchsorted(middles, t)
