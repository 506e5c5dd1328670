"""Fewer triangles: clean-up, decimation, what is seen, skinning weights."""
