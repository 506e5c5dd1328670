"""Precomputed radiance transfer of things that deform: cast by rays, learned by networks over geometry images."""
