"""Plugins of one light each: what surfaces give off themselves, and the lamp of every view."""
