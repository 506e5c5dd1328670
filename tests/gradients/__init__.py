"""Gradients of both renderers against central finite differences; see docs/gradients.md for the table."""
