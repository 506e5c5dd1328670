"""Settings files of commands that have their own: a forest, and precomputed transfer."""
