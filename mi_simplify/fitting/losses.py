"""
Image losses, per channel and pixel, and the one place where they are reduced and weighed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..registry import Registry

ImageLoss = Callable[[Any, Any], Any]


def srgb(x):
    """
    The sRGB transfer function Γ of linear values >= 0 (Hasselgren et al. 2021, Eq. 4).
    """
    # The root has no finite derivative at 0, where the linear branch is taken anyway.
    return dr.select(x <= 0.0031308, 12.92 * x, 1.055 * dr.power(dr.maximum(x, 0.0031308), 1 / 2.4) - 0.055)


def tonemap_log(x):
    """
    ``Γ(log(x + 1))``: robust to the full range of radiance (Hasselgren et al. 2021, Sect. 5.3).
    """
    # No slope at exactly 0: unlit pixels would shout with a slope of 12.9 where nothing can be done about them, and
    # drown the outlines (silhouette error of a skull after 100 steps: .0033 without, .0037 with, from .0038).
    return srgb(dr.log(dr.maximum(x, 0) + 1))


def log_l1(image, reference):
    """``|Γ(log(x+1)) - Γ(log(y+1))|``, the paper's loss."""
    return dr.abs(tonemap_log(image) - tonemap_log(reference))


def log_l2(image, reference):
    """``(Γ(log(x+1)) - Γ(log(y+1)))²``."""
    return dr.square(tonemap_log(image) - tonemap_log(reference))


def l1(image, reference):
    """``|x - y|``."""
    return dr.abs(image - reference)


def l2(image, reference):
    """``(x - y)²``, the paper's choice for foliage."""
    return dr.square(image - reference)


def smape(image, reference):
    """``|x - y| / (|x| + |y| + 0.01)`` (Vogels et al. 2018, Eq. 2)."""
    return dr.abs(image - reference) / (dr.abs(image) + dr.abs(reference) + 0.01)


def relative_l2(image, reference):
    """``(x - y)² / (y² + 0.01)``: noisy targets do not bias it (Lehtinen et al. 2018)."""
    return dr.square(image - reference) / (dr.square(reference) + 0.01)


LOSSES: Registry[ImageLoss] = Registry("loss (loss.image)")


def register_loss(name: str, loss: ImageLoss, *, replace: bool = False) -> None:
    """
    Make an image loss known to ``loss.image``.

    Parameters
    ----------
    name : str
    loss : callable
        ``loss(image, reference)``: two ``mi.Color3f`` of linear radiance to one of the same width, elementwise,
        differentiable in the first; its slope should vanish where both are equal.

    Raises
    ------
    ValueError
        The name is taken.
    """
    LOSSES.register(name, loss, replace=replace)


for _loss in (log_l1, log_l2, l1, l2, smape, relative_l2):
    register_loss(_loss.__name__, _loss)


def image_loss(name: str) -> ImageLoss:
    """
    The loss of this name.

    Raises
    ------
    ConfigError
        No such loss.
    """
    return LOSSES[name]


def compose(image: mi.Vector4f, background: mi.Color3f) -> mi.Color3f:
    """
    Premultiplied radiance and coverage over a background.
    """
    return mi.Color3f(image.xyz) + (1 - image.w) * background


def frame_loss(image: mi.Vector4f, reference: mi.Vector4f, background: mi.Color3f, loss: Callable, coverage):
    """
    Mean loss of a batch of pixels over a shared background, plus the coverage term, and its derivative by the image.

    Parameters
    ----------
    image, reference : mi.Vector4f, width N
        Premultiplied linear radiance and coverage. A pixel whose reference is NaN does not count.
    background : mi.Color3f, width N
        Linear radiance behind both.
    loss : callable
        One of :data:`LOSSES`.
    coverage : float or mi.Float
        Weight of the mean squared coverage difference; without it textures explain away holes and webs.

    Returns
    -------
    value : mi.Float, width 1
    grad : mi.Vector4f, width N
        ∂value/∂image. Both in one kernel, which passes over pixels that are equal, such as those of the background.
    """
    n = dr.width(image)

    def differ(image, reference, background):
        image = mi.Vector4f(image)
        dr.enable_grad(image)
        value = dr.mean(loss(compose(image, background), compose(reference, background)))
        value += coverage * dr.square(image.w - reference.w)
        dr.set_grad(value, 1 / n)
        dr.enqueue(dr.ADMode.Backward, value)
        dr.traverse(dr.ADMode.Backward)
        return dr.detach(value), dr.grad(image)

    def equal(image, reference, background):
        return mi.Float(0), mi.Vector4f(0)

    image, reference = mi.Vector4f(dr.detach(image)), mi.Vector4f(reference)
    counts = dr.any(image != reference) & ~dr.any(dr.isnan(reference))
    value, grad = dr.if_stmt((image, reference, background), counts, differ, equal)
    dr.eval(value, grad)
    return dr.sum(value) / n, grad
