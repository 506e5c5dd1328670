"""
The optimisation loop: draw views, render both sides, carry the difference back, step.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config import Config
from ..integrators.deferred import DeferredRenderer
from ..latent.latent import Latent
from ..latent.model import Model
from ..progress import Progress, ProgressCallback, silent
from ..scenes.reference import Reference
from ..scenes.views import goniometer
from ..upload import upload
from .laplacian import Laplacian
from .losses import frame_loss, image_loss, srgb
from .pool import ViewPool
from .residual import PathResidual
from .schedules import exponential, laplacian_weight, resolution_at
from .texels import TexelAdam
from .vertices import VertexSteps

log = logging.getLogger("mi_simplify")


@dataclass
class FitResult:
    """
    The fitted model, in the frame of the first guess, and one record per logged step.
    """

    model: Model
    log: list[dict] = field(default_factory=list)


class Fit:
    """
    A run of the optimiser over one latent model.

    Parameters
    ----------
    model : Model
        First guess in the normalised frame (box of side 2, centre 0).
    reference : Reference
        Black box that renders views.
    config : Config
    """

    def __init__(self, model: Model, reference: Reference, config: Config):
        self.config = config
        optimize, rates = set(config.latent.optimize), config.optimizer.rates
        self.latent = Latent(model, extended=bool(optimize & {"opacity", "gamma"}) or model.alpha_mode != "OPAQUE")
        mesh = self.latent.topology.mesh
        matched = config.reference.transport == "matched"
        self.renderer = DeferredRenderer(self.latent.topology, form=config.latent.shading, shadows=matched)
        large_steps = config.optimizer.large_steps
        self.vertices = VertexSteps(
            mesh.positions, mesh.position_faces, rates.vertices, large_steps.lambda_ if large_steps.enabled else 0.0
        )
        self.moves = "vertices" in optimize
        color_rates = dict.fromkeys(("base_color", "opacity"), rates.base_color)
        specular_rates = dict.fromkeys(("gamma", "roughness", "metallic"), rates.specular)
        texel_rates = {**color_rates, **specular_rates, "normal": rates.normal}
        self.texels = TexelAdam(
            self.latent.textures, {k: v for k, v in texel_rates.items() if k in optimize}, config.latent.min_roughness
        )
        self.laplacian = Laplacian(mesh.position_faces, mesh.positions, config.loss.laplacian.relative)
        self.loss = image_loss(config.loss.image)
        self._coverage = dr.opaque(mi.Float, config.loss.coverage)
        self._laplacian_start: float | None = None

        view = config.views
        draw = partial(
            _draw, distance=view.distance, jitter=view.jitter, fov=view.fov, exponent=view.light.exponent,
            irradiance=view.light.irradiance,
        )  # fmt: skip
        residual = None
        if matched:
            residual = PathResidual(
                self._state, self.renderer,
                spp=config.reference.spp, max_depth=config.reference.max_depth, form=config.latent.shading,
            )  # fmt: skip
        self.pool = ViewPool(reference, draw, config.reference.pool, np.random.default_rng(config.seed), residual)
        held_out = config.evaluation
        resolution = min(held_out.resolution, max(config.optimizer.resolution))
        self.held_out = draw(min(held_out.views, 8), np.random.default_rng(config.seed + 1), resolution)
        self._held_out_images = reference.render(self.held_out, seed=1)

    def step(self, index: int) -> mi.Float:
        """
        One step; returns the image loss, width 1, not read back.
        """
        config, progress = self.config, index / max(1, self.config.optimizer.steps)
        resolution = resolution_at(progress, config.optimizer.resolution)
        batch = config.optimizer.batch
        if self.pool.resolution != resolution:
            self.pool.grow(max(2 * batch, _REFRESH_EVERY * config.reference.refresh), resolution)
        elif index % _REFRESH_EVERY == 0:
            self.pool.grow(_REFRESH_EVERY * config.reference.refresh, resolution)
        views, reference, residual = self.pool.batch(batch)
        seed = dr.opaque(mi.UInt32, (config.seed * 1_000_003 + index * 7919) & 0xFFFFFFFF)

        positions = self.vertices.positions()
        leaf = mi.Float(dr.detach(positions))
        if self.moves:
            self.renderer.move(leaf)
            dr.enable_grad(leaf)
        surface = self.latent.evaluate(leaf)
        frame = self.renderer.render(surface, self.latent.textures, views, spp=config.optimizer.spp, seed=seed)

        background = self._background(dr.width(frame.image), seed)
        loss, grad_image = frame_loss(frame.image + residual, reference, background, self.loss, self._coverage)
        texel_grad = self.renderer.backward(
            frame, grad_image, surface, self.latent.textures, leaf, seed ^ dr.opaque(mi.UInt32, 0x5BD1E995)
        )
        del frame  # its graph holds on to the textures, which then could not be written in place
        if self.moves and config.loss.laplacian.weight > 0:
            dr.backward(self.laplacian.loss(leaf) * self._laplacian_weight(loss, progress))
        factor = exponential(progress, config.optimizer.decay)
        if texel_grad is not None:
            self.texels.step(texel_grad, dr.opaque(mi.Float, factor))
        if self.moves:
            self.vertices.step(dr.grad(leaf), positions, factor)
        return loss

    def _laplacian_weight(self, loss: mi.Float, progress: float) -> mi.Float:
        laplacian = self.config.loss.laplacian
        if self._laplacian_start is None:
            self._laplacian_start = laplacian.weight * float(loss[0]) / max(self.laplacian.absolute_start, 1e-12)
        return dr.opaque(mi.Float, self._laplacian_start * laplacian_weight(progress, laplacian.decay_to))

    def _background(self, n: int, seed: mi.UInt32) -> mi.Color3f:
        if self.config.views.background == "black":
            return mi.Color3f(0)
        pixel = dr.arange(mi.UInt32, n)
        a, b = mi.sample_tea_32(pixel, seed + 17, 6)
        c, _ = mi.sample_tea_32(pixel, seed + 18, 6)
        return mi.Color3f(*(mi.Float(x) * 2.0**-32 for x in (a, b, c)))

    def _state(self):
        with dr.suspend_grad():
            positions = self.vertices.positions()
            self.renderer.move(positions)
            return self.latent.model(positions.numpy()), self.latent.evaluate(positions), self.latent.textures

    def judge(self) -> tuple[float, float]:
        """
        How good the current state is on views that are never fitted.

        Returns
        -------
        loss : float
            What is minimised, without the Laplacian.
        psnr : float
            Of clipped sRGB on black, mean over views [dB].
        """
        _, surface, textures = self._state()
        seed = dr.opaque(mi.UInt32, 1)
        with dr.suspend_grad():
            frame = self.renderer.render(surface, textures, self.held_out, spp=16, seed=seed)
        image = frame.image.numpy().T.reshape(self._held_out_images.shape)
        if self.pool.residual is not None:
            image = image + self.pool.residual.render(self.held_out, 1)
        pixels = [upload(mi.Vector4f, x.reshape(-1, 4)) for x in (image, self._held_out_images)]
        loss, _ = frame_loss(*pixels, self._background(dr.width(pixels[0]), seed), self.loss, self._coverage)
        a, b = (srgb(dr.clip(x.xyz, 0, 1)).numpy().T.reshape(len(image), -1) for x in pixels)
        mse = ((a - b) ** 2).mean(1)
        return float(loss[0]), float(np.mean(-10 * np.log10(np.maximum(mse, 1e-10))))

    def model(self) -> Model:
        """
        The current state as a model.
        """
        return self.latent.model(dr.detach(self.vertices.positions()).numpy())


def _draw(n, rng, resolution, *, distance, jitter, fov, exponent, irradiance):
    return goniometer(
        n, rng, width=resolution, height=resolution, distance=distance, jitter=jitter, fov=fov,
        light_exponent=exponent, irradiance=irradiance,
    )  # fmt: skip


def fit(
    model: Model,
    reference: Reference,
    config: Config,
    progress: ProgressCallback = silent,
    on_step: Callable[[Fit, int], None] | None = None,
) -> FitResult:
    """
    Optimise a first guess until it looks like the reference.

    Minimises the expected image loss over random views (Hasselgren et al. 2021, Eq. 1 and 6), and returns the state
    with the least loss on held-out views, which may be the first guess itself: a warning says so.

    Parameters
    ----------
    model : Model
        First guess in the normalised frame.
    reference : Reference
    config : Config
        Sections ``views``, ``optimizer``, ``loss``, ``latent``, ``reference.pool`` and ``evaluation.every`` are read.
    progress : callable
    on_step : callable, optional
        ``on_step(fit, index)`` after every step: checkpoints, pictures.

    Returns
    -------
    FitResult
    """
    n_steps, every = config.optimizer.steps, config.evaluation.every
    if n_steps == 0:
        return FitResult(model)
    run, records, start = Fit(model, reference, config), [], time.perf_counter()
    least, _ = run.judge()
    best, best_step = model, 0
    for index in range(n_steps):
        loss = run.step(index)
        judged = (index + 1) % every == 0 or index + 1 == n_steps
        if judged or index % _LOG_EVERY == 0:
            record = {"step": index + 1, "loss": float(loss[0]), "seconds": round(time.perf_counter() - start, 3)}
            if judged:
                held_out, record["psnr"] = run.judge()
                record["held_out_loss"] = held_out
                if held_out < least:
                    least, best, best_step = held_out, run.model(), index + 1
            records.append(record)
            progress(Progress("fit", index + 1, n_steps, record["loss"], record.get("psnr")))
        if on_step is not None:
            on_step(run, index)
    if best_step == 0:
        log.warning("no step of the fit was better on held-out views than the first guess, which is kept as it was")
    elif best_step < n_steps:
        log.info("the model of step %d of %d is kept: it was the best on held-out views", best_step, n_steps)
    return FitResult(best, records)


#: Steps between two renewals of the pool: fewer, larger ones cost less.
_REFRESH_EVERY = 16

#: Steps between two readings of the loss; each waits for the device.
_LOG_EVERY = 10
