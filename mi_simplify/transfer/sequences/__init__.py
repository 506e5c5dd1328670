"""Surfaces that deform, frame by frame: from files, from blend shapes, and a cloth of our own."""
