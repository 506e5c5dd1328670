"""Surfaces as geometry images: made into discs, mapped to the square, resampled to n × n vertices (Gu et al. 2002)."""
