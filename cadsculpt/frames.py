"""Frames: the sculpted patches on a display grid, with what acts on them, for pictures and series over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .physics.lattice import hexahedra
from .physics.measures import nodal_plastic_set, nodal_strain, nodal_stress
from .record import Frame, LatticeFrame, PatchFrame, ToolFrame
from .session import Session
from .tools.outline import outline, outline_points
from .tools.surface import SurfaceTool

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
    """Makes frames of a session; precomputes what does not change. `names` : of the models' patches, unlike each other."""

    session: Session
    names: tuple[str, ...]
    _views: list[_PatchView]
    _outlines: list[tuple[Array, Index]]

    @classmethod
    def of(cls, session: Session) -> FrameMaker:
        model = session.model
        views = []
        sculpted = [patch for patch in model.patches if patch.body < model.models]
        for patch in sculpted:
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
        several = model.models > 1
        names = tuple(f"{model.bodies[p.body]}: {p.name}" if several else p.name for p in sculpted)
        return cls(session, names, views, [outline(tool.tool, scene_size=model.size) for tool in model.tools])

    def parameters(self) -> list[tuple[Array, Array]]:
        """Per patch the parameters u and v of the frames' rows and columns."""
        matrices = [patch.grid.matrices for patch in self.session.model.patches]
        return [(m.u[view.rows], m.v[view.columns]) for m, view in zip(matrices, self._views, strict=False)]

    def frame(self) -> Frame:
        """The session as it is now."""
        session, model, state = self.session, self.session.model, self.session.state
        pascal = model.metres_per_unit**-2
        patches = []
        for index, (patch, view) in enumerate(zip(model.patches, self._views, strict=False)):
            matrices = patch.grid.matrices
            points = matrices.points(state.control_points[index], patch.surface.weights)[
                np.ix_(view.rows, view.columns)
            ]
            pressure = np.zeros(view.rest.shape[:2])
            contact = np.zeros(view.rest.shape[:2], dtype=np.bool_)
            for mine, u, v in self._touched(index):
                c = session.contacts
                i = _nearest(matrices.u[view.rows], u)
                j = _nearest(matrices.v[view.columns], v)
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
        tools = tuple(self._tool(number) for number in range(len(model.tools)))
        return Frame(state.step, state.time, tuple(patches), tools)

    def _touched(self, patch: int) -> list[tuple[Index, Array, Array]]:
        """The contacts on a model's patch, as rows and the parameters u and v there: those listed on it, and those with bodies
        that come before its own."""
        model, c = self.session.model, self.session.contacts
        body, deep = model.patches[patch].body, self.session.depths > 0
        mine = np.flatnonzero((c.face == patch) & deep)
        place = model.faces_of[body].index(patch)
        other = np.flatnonzero((c.b == body) & (c.tool_face == place) & deep)
        found = [(mine, c.u[mine], c.v[mine]), (other, c.tool_u[other], c.tool_v[other])]
        return [rows for rows in found if len(rows[0])]

    def _tool(self, number: int) -> ToolFrame:
        """A tool as it is now."""
        state, tool = self.session.state, self.session.model.tools[number]
        pose, (points, triangles) = state.poses[number], self._outlines[number]
        if not tool.patches or not isinstance(tool.tool, SurfaceTool):
            return ToolFrame(tool.name, pose.to_world(points), triangles)
        now = pose.to_world(outline_points(tool.tool, [state.control_points[i] for i in tool.patches]))
        return ToolFrame(tool.name, now, triangles, now - pose.to_world(points))

    def lattices(self) -> list[LatticeFrame]:
        """The hexahedra of every patch as they are now, those of tools behind those of models."""
        model = self.session.model
        tools = [f"{model.bodies[p.body]}: {p.name}" for p in model.patches[len(self.names) :]]
        names = [*self.names, *tools]
        return [
            LatticeFrame(
                name=names[i],
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
