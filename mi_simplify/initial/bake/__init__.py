"""Textures read off the detailed surface."""
