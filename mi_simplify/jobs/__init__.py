"""Whole jobs, from the asset to the report, and what they will take."""
