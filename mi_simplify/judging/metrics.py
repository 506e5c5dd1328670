"""
How alike two sets of images are: PSNR, FLIP and silhouette error.

All take linear images on black and compare what a screen shows: clipped, sRGB. These are the
definitions of the project's judge, so the figures can be set beside its own.
"""

from __future__ import annotations

import flip_evaluator
import numpy as np

from ..model.color import linear_to_srgb

COVERED = 0.5
"""Coverage from which a pixel counts as covered."""

FLIP_REACH = 24
"""Pixels that FLIP's filters reach at 67 pixels per degree, one after the other, with a little more."""

FLAT = 1.0
"""Angle up to which a normal in tangent space counts as flat [degrees]."""


def tonemap(linear: np.ndarray) -> np.ndarray:
    """
    What a screen shows of linear radiance: clipped to [0, 1], sRGB curve, no exposure.

    Parameters
    ----------
    linear : ndarray, shape (..., C), C >= 3
        Linear RGB; further channels are dropped.

    Returns
    -------
    ndarray, shape (..., 3), float32
        sRGB in [0, 1].
    """
    return linear_to_srgb(np.asarray(linear)[..., :3]).astype(np.float32)


def psnr(reference: np.ndarray, candidate: np.ndarray) -> np.ndarray:
    """
    Peak signal-to-noise ratio of the tone-mapped images, per view.

    Parameters
    ----------
    reference, candidate : ndarray, shape (B, H, W, C), C >= 3
        Linear radiance.

    Returns
    -------
    ndarray, shape (B,), float64
        [dB]; 100 where the images are equal. The figure for a set of views is the mean of these.
    """
    a, b = _pair(reference, candidate)
    mse = ((tonemap(a) - tonemap(b)) ** 2).mean((1, 2, 3), dtype=np.float64)
    return -10.0 * np.log10(np.maximum(mse, 1e-10))


def converged_psnr(references: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """
    :func:`psnr` of images without noise, from two independent noisy ones of each.

    The square of a difference has the variance of its noise in it; the product of two differences whose noise is
    independent has not: E[(A₁ - B₁) (A₂ - B₂)] = (E[A] - E[B])².

    Parameters
    ----------
    references, candidates : ndarray, shape (2, B, H, W, C), C >= 3
        Linear radiance.

    Returns
    -------
    ndarray, shape (B,), float64
        [dB]; a difference below a fiftieth of the noise cannot be told from none and counts as that much.
    """
    a, b = _pair(references, candidates)
    first, second = (tonemap(x) - tonemap(y) for x, y in zip(a, b, strict=True))
    mse = (first * second).mean((1, 2, 3), dtype=np.float64)
    noisy = ((first + second) ** 2 / 4).mean((1, 2, 3), dtype=np.float64)
    return -10.0 * np.log10(np.maximum(np.maximum(mse, noisy / 50), 1e-10))


def flip_maps(reference: np.ndarray, candidate: np.ndarray) -> np.ndarray:
    """
    FLIP error per pixel (Andersson et al. 2020, LDR, 67 pixels per degree).

    Parameters
    ----------
    reference, candidate : ndarray, shape (B, H, W, C), C >= 3
        Linear radiance.

    Returns
    -------
    ndarray, shape (B, H, W), float32
        0 where no difference is seen, 1 at most.
    """
    a, b = _pair(reference, candidate)
    maps = np.zeros(a.shape[:3], np.float32)
    for x, y, error in zip(tonemap(a), tonemap(b), maps, strict=True):
        seen = _lit(x, y)  # where both are black for as far as the filters reach there is no error
        pair = np.ascontiguousarray(x[seen]), np.ascontiguousarray(y[seen])
        error[seen] = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False, computeMeanError=False)[0][..., 0]
    return maps


def _lit(a: np.ndarray, b: np.ndarray) -> tuple[slice, slice]:
    """The least window outside which two images, shape (H, W, 3), are black, grown by what FLIP's filters reach."""
    lit = (a + b).any(2)

    def span(hit: np.ndarray) -> slice:
        where = np.flatnonzero(hit)
        return slice(max(0, where[0] - FLIP_REACH), where[-1] + 1 + FLIP_REACH) if len(where) else slice(0, 1)

    return span(lit.any(1)), span(lit.any(0))


def flip(reference: np.ndarray, candidate: np.ndarray) -> np.ndarray:
    """
    Mean FLIP error per view, shape (B,); see :func:`flip_maps`.
    """
    return flip_maps(reference, candidate).mean((1, 2), dtype=np.float64)


def silhouette_error(reference_coverage: np.ndarray, candidate_coverage: np.ndarray) -> float:
    """
    Pixels that only one of the two covers, over pixels that the reference covers; all views pooled.

    Parameters
    ----------
    reference_coverage, candidate_coverage : ndarray, any one shape
        In [0, 1]; a pixel is covered from 0.5 on.

    Returns
    -------
    float
        0 for equal outlines; may exceed 1.
    """
    a, b = _pair(reference_coverage, candidate_coverage)
    a, b = a > COVERED, b > COVERED
    return float(np.count_nonzero(a != b) / max(1, int(np.count_nonzero(a))))


def normal_dissimilarity(normals: np.ndarray, reference: np.ndarray, shown: np.ndarray | None = None) -> float:
    """
    How far a normal map is from another of the same coordinates, over the texels where that is not flat.

    The mean of one minus the cosine between both (Takimoto et al. 2022, supplement, Eq. 1). Flat is what is within
    :data:`FLAT` of the surface's own normal: 8 bits cannot store (0, 0, 1).

    Parameters
    ----------
    normals, reference : ndarray, shape (H, W, 3)
        Unit vectors in tangent space.
    shown : ndarray, shape (H, W), bool, optional
        Texels that any triangle shows; the others are not counted, as no image says anything of them.

    Returns
    -------
    float
        0 for equal maps, 2 at most; NaN where the reference is flat everywhere.
    """
    a, b = _pair(normals, reference)
    counted = b[..., 2] < np.cos(np.radians(FLAT)) * np.linalg.norm(b, axis=2)
    if shown is not None:
        counted &= shown
    if not counted.any():
        return float("nan")
    a, b = a[counted].astype(np.float64), b[counted].astype(np.float64)
    length = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return float(np.mean(1 - np.sum(a * b, axis=1) / np.maximum(length, 1e-20)))


def compare(reference: np.ndarray, candidate: np.ndarray) -> dict[str, object]:
    """
    All figures of one candidate.

    Parameters
    ----------
    reference, candidate : ndarray, shape (B, H, W, 4) or (2, B, H, W, 4)
        Linear radiance on black, and coverage; or two independent renderings of each, of which PSNR is that without
        noise, and all else that of their mean.

    Returns
    -------
    dict
        ``psnr`` [dB], ``flip``, ``silhouette_error`` over all views, and the same names under
        ``per_view``, each a list of B numbers.
    """
    a, b = _pair(reference, candidate)
    if a.ndim == 5:
        decibels, a, b = converged_psnr(a, b), a.mean(0), b.mean(0)
    else:
        decibels = psnr(a, b)
    per_view = {
        "psnr": decibels.tolist(),
        "flip": flip(a, b).tolist(),
        "silhouette_error": [silhouette_error(x, y) for x, y in zip(a[..., 3], b[..., 3], strict=True)],
    }
    return {
        "psnr": float(np.mean(per_view["psnr"])),
        "flip": float(np.mean(per_view["flip"])),
        "silhouette_error": silhouette_error(a[..., 3], b[..., 3]),
        "per_view": per_view,
    }


def _pair(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays of one shape."""
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape:
        raise ValueError(f"images of one shape expected, got {a.shape} and {b.shape}")
    return a, b
