"""One face prepared for sculpting: its net refined, its lattice, matrices and refit made (paper section 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .collide.detect import PatchGrid
from .physics.contact_law import ContactLaw
from .physics.explicit import stable_substep
from .physics.inward import inward_directions
from .physics.lattice import Lattice, build_lattice
from .physics.material import Material
from .physics.node_grid import NodeGrid, Span, node_grid
from .scene import Scene
from .spline.hold import Hold, in_range
from .spline.refit import Refit
from .spline.surface import BSplineSurface
from .spline.trim import box as trim_box
from .spline.trim import inside
from .substance import Substance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Window = tuple[tuple[float, float], tuple[float, float]]

GHOST = 1e-3
"""Stiffness and density of the nodes outside a trimmed face, as a fraction of the material's (finite cell method: Parvizian,
Duester, Rank 2007): soft enough to carry nothing, stiff enough to move along, so that the refit has data on both sides."""

COLLAPSED = 0.2
"""Nodes stop where the iso-curves towards a pole are shorter than this fraction of the longest one: nearer to the pole the
cells are slivers that would dictate the time step."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceEdge:
    """An edge of a face to be sculpted: uv (n, 2) along it, and the names of the other faces that share it.

    tolerance : how far apart the file lets these faces be there, in the scene's unit; 0 when it does not say. stated : it is
    what the file says of all its geometry, not of this edge.
    """

    uv: Array
    neighbours: tuple[str, ...] = ()
    seam: bool = False
    degenerate: bool = False
    tolerance: float = 0.0
    stated: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SourceFace:
    """A face to be sculpted, in the scene's unit. `number` is the face's number in its part."""

    number: int
    name: str
    surface: BSplineSurface
    edges: tuple[SourceEdge, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RigidFace:
    """One face of a rigid model."""

    body: int
    source: SourceFace
    grid: PatchGrid

    @property
    def name(self) -> str:
        return self.source.name


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """One face of a deformable body, prepared; that of a tool in the tool's frame.

    body : its number, models before tools. source : the face as read. surface : the same shape over a net fine enough to
    take the dent; `grid` (collision), `lattice` (physics) and `refit` are made for it. u, v : node parameters.
    held (r, s) : control points that never move. contact_stiffness [N/L^3], contact_damping [N s/L^3] : of its material
    against something rigid. hold : what of the face stays where it is. slivers : knot spans, along u and along v, that are too
    narrow for a node.
    """

    body: int
    source: SourceFace
    surface: BSplineSurface
    grid: PatchGrid
    lattice: Lattice
    refit: Refit
    u: Array
    v: Array
    held: NDArray[np.bool_]
    material_nodes: NDArray[np.bool_]
    law: ContactLaw
    substep: float
    """The largest stable sub-step of the explicit integrator, contact included, in s."""
    hold: Hold
    slivers: tuple[list[Span], list[Span]]

    @property
    def name(self) -> str:
        return self.source.name


def build_patch(
    scene: Scene,
    substance: Substance,
    body: int,
    face: SourceFace,
    spacing: tuple[float, float],
    swept: Array,
    unit: float,
    siblings: frozenset[str] = frozenset(),
) -> Patch:
    """Prepare one face. swept (k, 2, 3) : boxes in the face's frame that together hold whatever may touch it, on its whole
    way. siblings : names of the other faces of its body, to which it is tied where they meet.

    Raises InputError or GeometryError.
    """
    source = face.surface if substance.outward is None else replace(face.surface, outward=substance.outward)
    source.validate()
    window = node_window(source)
    reached = reached_window(source, window, max(spacing), swept) if scene.refit.refine else None
    nodes = node_grid(source, spacing, window=window, refine=reached)
    surface = nodes.surface
    points = surface.evaluate(nodes.u[:, None], nodes.v)
    inward = inward_directions(
        points,
        surface.normal(nodes.u[:, None], nodes.v),
        nodes.u,
        nodes.v,
        thickness=substance.thickness,
        wrap=(nodes.wrap_u, nodes.wrap_v),
    )
    material = scene.material_of(substance.material)
    on_face = cells_on_face(surface, nodes.u, nodes.v, wrap=(nodes.wrap_u, nodes.wrap_v))
    ghost = replace(
        material,
        youngs_modulus=GHOST * material.youngs_modulus,
        density=GHOST * material.density,
        yield_strain=float("inf"),
        name="beyond the trims",
    )
    materials, index = _zones(scene, substance, face, surface, nodes, [material, ghost])
    thickness = substance.thickness
    borders = held_edges(substance, face, siblings)
    hold = _hold(scene, face, borders)
    lattice = build_lattice(
        points,
        inward,
        nodes.u,
        nodes.v,
        thickness=thickness,
        layers=substance.layers,
        material=materials,
        cell_material=np.where(on_face, index, 1),
        wrap=(nodes.wrap_u, nodes.wrap_v),
        period=(surface.domain[0][1] - surface.domain[0][0], surface.domain[1][1] - surface.domain[1][0]),
        anchored=_anchored(substance, face, nodes, borders, siblings, hold),
        metres_per_unit=unit,
    )
    held = _held(surface, nodes, hold)
    # what lies beyond the trims is touched as what lies beside it
    law = ContactLaw(lattice, (material, material, *materials[2:]), min(spacing), scene.solver.max_penetration)
    return Patch(
        body=body,
        source=face,
        surface=surface,
        grid=PatchGrid.of(surface, scene.solver.resolution),
        lattice=lattice,
        refit=Refit.of(surface, nodes.u, nodes.v, held, nodes.slivers),
        u=nodes.u,
        v=nodes.v,
        held=held,
        material_nodes=nodes_of_cells(on_face, wrap=(nodes.wrap_u, nodes.wrap_v)),
        law=law,
        substep=stable_substep(lattice),
        hold=hold,
        slivers=nodes.slivers,
    )


def held_edges(substance: Substance, face: SourceFace, siblings: frozenset[str]) -> list[SourceEdge]:
    """The edges of a face that stay where they are: those to faces that are not sculpted with it."""
    if substance.edges == "free":
        return []
    return [
        edge for edge in face.edges if edge.neighbours and not edge.seam and not siblings.issuperset(edge.neighbours)
    ]


def build_rigid_face(scene: Scene, outward: bool | None, body: int, face: SourceFace) -> RigidFace:
    """Prepare a face of a rigid model for collision."""
    surface = face.surface if outward is None else replace(face.surface, outward=outward)
    surface.validate()
    return RigidFace(body, face, PatchGrid.of(surface, scene.solver.resolution))


def _zones(
    scene: Scene,
    substance: Substance,
    face: SourceFace,
    surface: BSplineSurface,
    nodes: NodeGrid,
    materials: list[Material],
) -> tuple[list[Material], NDArray[np.int64]]:
    """The zones' materials behind `materials`, and each cell's index among them: a cell belongs where its middle lies."""
    u = _cell_middles(nodes.u, surface, 0, wrap=nodes.wrap_u)
    v = _cell_middles(nodes.v, surface, 1, wrap=nodes.wrap_v)
    index = np.zeros((len(u), len(v)), dtype=np.int64)
    for zone in substance.zones:
        if zone.face is None or zone.face in (face.name, face.number):
            materials = [*materials, scene.material_of(zone.material)]
            index[in_range(u, zone.u)[:, None] & in_range(v, zone.v)[None, :]] = len(materials) - 1
    return materials, index


def mean_lengths(surface: BSplineSurface) -> tuple[float, float]:
    """Mean length of the face along u and along v, inside its trims' box."""
    (u0, u1), (v0, v1) = face_window(surface)
    points = surface.evaluate(np.linspace(u0, u1, 33)[:, None], np.linspace(v0, v1, 33))
    return (
        float(np.linalg.norm(np.diff(points, axis=0), axis=2).sum(axis=0).mean()),
        float(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1).mean()),
    )


def face_window(surface: BSplineSurface) -> tuple[tuple[float, float], tuple[float, float]]:
    """The piece of the domain that holds the trimmed face: the trims' box, cut to the domain."""
    (u0, u1), (v0, v1) = surface.domain
    if surface.trims is None:
        return (u0, u1), (v0, v1)
    low, high = trim_box(surface.trims)
    u = (max(u0, float(low[0])), min(u1, float(high[0])))
    v = (max(v0, float(low[1])), min(v1, float(high[1])))
    return (u if u[0] < u[1] else (u0, u1)), (v if v[0] < v[1] else (v0, v1))


def node_window(surface: BSplineSurface) -> Window:
    """The piece of the domain that gets nodes: the trimmed face's box with a margin, short of poles.

    A box that leaves out less than three tenths of the domain is the whole domain: cutting would cost more than it saves.
    """
    result = []
    for axis, (low, high) in enumerate(face_window(surface)):
        start, end = surface.domain[axis]
        margin = 0.1 * (high - low)
        low, high = max(start, low - margin), min(end, high + margin)
        if high - low > 0.7 * (end - start):
            low, high = start, end
        result.append((low, high))
    for axis in (0, 1):
        low, high = result[axis]
        t = np.linspace(low, high, 201)
        across = np.linspace(*result[1 - axis], 33)
        points = surface.evaluate(t[:, None], across) if axis == 0 else surface.evaluate(across[None, :], t[:, None])
        length = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
        wide = np.flatnonzero(length >= COLLAPSED * length.max())
        if len(wide):
            result[axis] = (
                low if length[0] > 1e-6 * length.max() else float(t[wide[0]]),
                high if length[-1] > 1e-6 * length.max() else float(t[wide[-1]]),
            )
    return result[0], result[1]


def reached_window(surface: BSplineSurface, window: Window, spacing: float, swept: Array) -> Window | None:
    """The (u, v) box of the surface that the swept boxes (k, 2, 3) come near to; None when they stay away from it."""
    u = np.linspace(*window[0], 65)
    v = np.linspace(*window[1], 65)
    points = surface.evaluate(u[:, None], v)
    step = max(float(np.linalg.norm(np.diff(points, axis=k), axis=2).max()) for k in (0, 1))
    reach = step + 3.0 * spacing
    hit = np.zeros(points.shape[:2], dtype=np.bool_)
    for low, high in swept:
        hit |= ((points >= low - reach) & (points <= high + reach)).all(axis=2)
    if not hit.any():
        return None
    rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
    return (
        (float(u[max(0, rows[0] - 1)]), float(u[min(64, rows[-1] + 1)])),
        (float(v[max(0, columns[0] - 1)]), float(v[min(64, columns[-1] + 1)])),
    )


def _cell_middles(t: Array, surface: BSplineSurface, axis: int, *, wrap: bool) -> Array:
    """Middle parameter of each cell of nodes; a closed direction has a last cell that runs over the seam."""
    ends = np.concatenate([t, [surface.domain[axis][1]]]) if wrap else t
    return 0.5 * (ends[1:] + ends[:-1])


def cells_on_face(surface: BSplineSurface, u: Array, v: Array, *, wrap: tuple[bool, bool]) -> Mask:
    """The cells of the nodes u (m,) x v (n,) whose middles lie within the face's trims. wrap : directions that are closed."""
    return inside(surface, _cell_middles(u, surface, 0, wrap=wrap[0]), _cell_middles(v, surface, 1, wrap=wrap[1]))


def nodes_of_cells(cells: Mask, *, wrap: tuple[bool, bool]) -> Mask:
    """Nodes (nu, nv) that belong to at least one of the marked cells."""
    nodes = cells
    for axis in (0, 1):
        if wrap[axis]:
            nodes = nodes | np.roll(nodes, 1, axis=axis)
        else:
            pad = [(1, 0) if k == axis else (0, 0) for k in (0, 1)]
            after = [(0, 1) if k == axis else (0, 0) for k in (0, 1)]
            nodes = np.pad(nodes, pad) | np.pad(nodes, after)
    return nodes


def _hold(scene: Scene, face: SourceFace, held_edges: Sequence[SourceEdge]) -> Hold:
    """What of a face stays where it is: held edges (their tangent planes too for G1), poles, and the fixed regions."""
    boxes = tuple((box.u, box.v) for box in scene.refit.fixed if box.face in (None, face.name, face.number))
    return hold_of(face, held_edges, boxes, smooth=scene.refit.continuity == "G1")


def hold_of(
    face: SourceFace,
    held_edges: Sequence[SourceEdge],
    boxes: tuple[tuple[Span | None, Span | None], ...] = (),
    *,
    smooth: bool,
) -> Hold:
    """Held edges (smooth : and their tangent planes), the face's poles, and boxes of (u, v) as what stays where it is."""
    lines = tuple(edge.uv for edge in held_edges)
    poles = tuple(edge.uv for edge in face.edges if edge.degenerate)
    return Hold(poles, lines, boxes) if smooth else Hold((*lines, *poles), (), boxes)


def _held(surface: BSplineSurface, nodes: NodeGrid, hold: Hold) -> Mask:
    """Control points that never move: what is held, and those that reach beyond the nodes' window."""
    held = hold.control_points(surface)
    for axis, (knots, degree) in enumerate(((surface.knots_u, surface.degree_u), (surface.knots_v, surface.degree_v))):
        low, high = nodes.window[axis]
        start, end = surface.domain[axis]
        count = surface.shape[axis]
        outside = np.zeros(count, dtype=np.bool_)
        if low > start:
            outside |= knots[:count] < low
        if high < end:
            outside |= knots[degree + 1 : degree + 1 + count] > high
        held |= outside[:, None] if axis == 0 else outside[None, :]
    return held


def _anchored(
    substance: Substance,
    face: SourceFace,
    nodes: NodeGrid,
    held: Sequence[SourceEdge],
    siblings: frozenset[str],
    hold: Hold,
) -> Mask:
    """Nodes (nu, nv, layers + 1) that stay where they are; layer 0 is the surface. An edge between two faces of the body is
    none of the body's edges."""
    through = hold.inside(nodes.u, nodes.v)  # anchored through the whole thickness
    wrap = (nodes.wrap_u, nodes.wrap_v)
    for edge in held:
        through |= _crossed(edge.uv, nodes)
    names: set[str] = set()
    if not isinstance(substance.anchor, str):
        for item in substance.anchor:
            if isinstance(item, str):
                names.add(item)
            elif item.face is None or item.face in (face.name, face.number):
                through |= in_range(nodes.u, item.u)[:, None] & in_range(nodes.v, item.v)[None, :]
    inner = [edge for edge in face.edges if edge.neighbours and siblings.issuperset(edge.neighbours)]
    for edge in face.edges:
        outer = substance.anchor == "edges" and edge not in inner
        if not edge.seam and (outer or names.intersection(edge.neighbours)):
            through |= _crossed(edge.uv, nodes)
    if substance.anchor == "edges" and not inner:
        for axis in (0, 1):
            if not wrap[axis]:
                border = (slice(None),) * axis + ([0, -1],)
                through[border] = True
    # a window cut out of the surface ends in material that goes on
    for axis in (0, 1):
        for end, index in ((0, 0), (1, -1)):
            if substance.anchor != "none" and nodes.window[axis][end] != nodes.surface.domain[axis][end]:
                through[(slice(None),) * axis + (index,)] = True
    anchored = np.repeat(through[:, :, None], substance.layers + 1, axis=2)
    if substance.anchor == "base":
        anchored[:, :, -1] = True
    return anchored


def _crossed(uv: Array, nodes: NodeGrid) -> Mask:
    """Nodes (nu, nv) at the corners of the cells that a polyline runs through."""
    mark = np.zeros((len(nodes.u), len(nodes.v)), dtype=np.bool_)
    points = np.concatenate([uv[:-1] + f * np.diff(uv, axis=0) for f in np.linspace(0, 1, 9)])
    for a in (0, 1):
        for b in (0, 1):
            i = _neighbour(points[:, 0], nodes.u, a, wrap=nodes.wrap_u)
            j = _neighbour(points[:, 1], nodes.v, b, wrap=nodes.wrap_v)
            mark[i, j] = True
    return mark


def _neighbour(t: Array, nodes: Array, side: int, *, wrap: bool) -> NDArray[np.int64]:
    index = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, len(nodes) - (1 if wrap else 2)) + side
    return index % len(nodes)
