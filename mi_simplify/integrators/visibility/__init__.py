"""
What jumps in the pictures of a plain Mitsuba scene, and how that moves: what the `direct_edge` plugin consists of.
"""
