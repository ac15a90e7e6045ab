"""The kernel with which `collide.py` asks NVIDIA Warp for pairs of triangles (Warp compiles it from this file)."""

import warp as wp


@wp.kernel
def meeting(
    shape: wp.uint64,
    corners: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=wp.int32),
    count: wp.array(dtype=wp.int32),
    out: wp.array2d(dtype=wp.int32),
):
    """Triangles of the mesh `shape` that meet triangle t of the tool: out (n, 2), as many as fit, and how many."""
    t = wp.tid()
    a = corners[faces[t, 0]]
    b = corners[faces[t, 1]]
    c = corners[faces[t, 2]]
    query = wp.mesh_query_aabb(shape, wp.min(wp.min(a, b), c), wp.max(wp.max(a, b), c))
    s = wp.int32(0)
    while wp.mesh_query_aabb_next(query, s):
        p = wp.mesh_eval_position(shape, s, 1.0, 0.0)
        q = wp.mesh_eval_position(shape, s, 0.0, 1.0)
        r = wp.mesh_eval_position(shape, s, 0.0, 0.0)
        if wp.intersect_tri_tri(p, q, r, a, b, c) != 0:
            at = wp.atomic_add(count, 0, 1)
            if at < out.shape[0]:
                out[at, 0] = s
                out[at, 1] = t
