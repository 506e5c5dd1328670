"""Formats that libraries of others read for us."""
