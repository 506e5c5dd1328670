"""Foliage as textured cards."""
