"""Mitsuba scenes."""
