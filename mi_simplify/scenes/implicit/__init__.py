"""Implicit surfaces and a library of distance functions."""
