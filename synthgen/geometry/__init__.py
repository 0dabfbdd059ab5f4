"""Rotations, rigid transforms, cameras, normals, subdivision and a reference rasteriser."""
