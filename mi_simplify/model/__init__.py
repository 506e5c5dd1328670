"""Meshes, materials and skeletons in plain NumPy; it imports nothing above it."""
