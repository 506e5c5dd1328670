"""Meshes of the user's own: made whole, put back in place, their UVs kept."""
