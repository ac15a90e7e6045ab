"""Triangle meshes as bodies: topology, a bounding tree, signed distance, distance of two meshes."""
