"""
Samples of a film: what is put on it, and what a derivative of the image consists of.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class FilmSamples:
    """
    N samples at film positions, in any order.

    Parameters
    ----------
    pos : mi.Point2f
        [pixels]; detached.
    value : mi.Spectrum
        Radiance at ``wavelengths``.
    coverage : mi.Float
    weight : mi.Float
        What a sample counts in its pixel's mean: 1 for camera samples, 0 for what is added to that.
    wavelengths : mi.Spectrum
        Empty in variants that are not spectral.
    per_pixel : int
        How many samples lie in each pixel, one after the other; 0 where they are not in that order.
    """

    pos: mi.Point2f
    value: mi.Spectrum
    coverage: mi.Float
    weight: mi.Float
    wavelengths: mi.Spectrum
    per_pixel: int = 0

    @property
    def width(self) -> int:
        """How many samples."""
        return max(dr.width(self.pos), dr.width(self.value))

    def put(self, film: mi.Film) -> None:
        """
        Add the samples to what is on a film.
        """
        block = film.create_block()
        block.set_coalesce(block.coalesce() and self.per_pixel >= 4)
        splat = mi.ad.integrators.common.ADIntegrator._splat_to_block
        splat(block, film, self.pos, self.value, self.weight, self.coverage, [], self.wavelengths)
        film.put_block(block)
