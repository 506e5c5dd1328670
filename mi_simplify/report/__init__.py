"""Metrics, pictures and the HTML report."""
