"""
One step of the fit: draw views, render both sides, carry the difference back, step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config import FitSettings
from ..config.schema import ViewsSettings
from ..errors import ConfigError
from ..integrators.deferred import DeferredRenderer
from ..integrators.soft.hard_soft import HardSoftRenderer
from ..latent.latent import Latent
from ..latent.surface import Surface
from ..latent.textures import Textures
from ..model.model import Model
from ..scenes.references.reference import OwnViews, Reference
from ..scenes.views import Views, goniometer
from .follow import following
from .held_out import HeldOut
from .kept import KeptStep
from .losses import frame_loss, image_loss
from .parameters.ambient import AmbientSteps
from .parameters.laplacian import Laplacian
from .parameters.shape import ShapeSteps
from .parameters.texels import TexelAdam
from .pool import ViewPool
from .residual import PathResidual
from .samples import LOOK_SEED, LOOK_SPP, Samples
from .schedules import exponential, laplacian_weight, resolution_at
from .sizes import at_sizes
from .stages import can_keep
from .tessellations import tessellating


class Fit:
    """
    A run of the optimiser over one latent model.

    Parameters
    ----------
    model : Model
        First guess in the normalised frame (box of side 2, centre 0).
    reference : Reference
        Black box that renders views.
    settings : FitSettings
    """

    def __init__(self, model: Model, reference: Reference, settings: FitSettings):
        self.settings, self.first_guess = settings, model
        optimize, rates = set(settings.latent.optimize), settings.optimizer.rates
        transparent = model.alpha_mode != "OPAQUE"
        if not transparent:
            optimize.discard("opacity")
        extended = optimize & {"opacity", "gamma"} or model.alpha_mode != "OPAQUE" or model.specular[..., 0].any()
        self.latent = Latent(model, extended=bool(extended), mips=settings.latent.mips)
        base = self.latent.operation.base
        matched = settings.reference.transport == "matched"
        self.renderer = DeferredRenderer(
            self.latent.topology, form=settings.latent.shading, shadows=matched,
            shade="sample" if transparent else settings.optimizer.shade,
            layers=settings.opacity.layers if transparent else 1,
            # Three times as many bring nothing that is seen in the result: what is noisy is not the edges.
            edge_fraction=0.05,
        )  # fmt: skip
        self._soft = None
        if settings.optimizer.visibility == "hard_soft":
            if transparent:
                raise ConfigError("optimizer.visibility: hard_soft is for opaque models; take edge for this one")
            widths = settings.optimizer.hard_soft.model_dump(exclude={"until"})
            form = settings.latent.shading
            self._soft = HardSoftRenderer(self.latent.topology, form=form, shadows=matched, **widths)
        self.latent.textures.cutoff = model.alpha_cutoff
        self.unpeeled = 0.0
        """Share of what :meth:`judge` saw last that lies behind more layers than were looked at."""
        large_steps = settings.optimizer.large_steps
        diffusion = large_steps.lambda_ if large_steps.enabled else 0.0
        self.shape = ShapeSteps(self.latent.operation, optimize, dict(rates), diffusion)
        texel_rates = {
            "base_color": rates.base_color, "normal": rates.normal, "gamma": rates.specular,
            "opacity": rates.base_color if rates.opacity is None else rates.opacity,
            "roughness": rates.specular if rates.roughness is None else rates.roughness,
            "metallic": rates.specular if rates.metallic is None else rates.metallic,
        }  # fmt: skip
        self.texels = TexelAdam(
            self.latent.textures, {k: v for k, v in texel_rates.items() if k in optimize}, settings.latent.min_roughness
        )
        self.ambient = AmbientSteps(model.ambient, settings.latent.ambient.optimize, rates.ambient)
        self.laplacian = Laplacian(base.position_faces, base.positions, settings.loss.laplacian.relative)
        self.loss = image_loss(settings.loss.image)
        self.coverage = dr.opaque(mi.Float, settings.loss.coverage)
        self._laplacian_start: float | None = None
        self.caution = 1.0
        """Factor of all rates, halved by :meth:`retreat`."""
        self.samples = Samples(reference, settings)
        """Their number is doubled by :meth:`retreat` where halved rates were not enough."""

        draw = reference.draw if isinstance(reference, OwnViews) else _by_chance(settings.views)
        residual = None
        if matched:
            residual = PathResidual(
                self._state, self.renderer,
                spp=settings.reference.samples, max_depth=settings.reference.max_depth, form=settings.latent.shading,
            )  # fmt: skip
        sized = partial(at_sizes, draw, settings.optimizer.least_resolution)
        of_batch, of_one = (
            tessellating(following(draw, model.skin, n), model.displacement, n)
            for draw, n in ((sized, settings.optimizer.batch), (draw, 1))
        )
        self._keeps = can_keep(settings, is_opaque=not transparent) and model.skin is None and residual is None
        self._kept: dict[int, KeptStep] = {}
        self.pool = ViewPool(
            self.samples, of_batch, settings.reference.pool, np.random.default_rng(settings.seed), residual, self._keeps
        )
        self.held_out = HeldOut(reference, of_one, settings, self.samples)

    def step(self, index: int, progress: float | None = None) -> mi.Float:
        """
        One step; returns the image loss, width 1, not read back.

        Parameters
        ----------
        index : int
            How many steps were done before.
        progress : float, optional
            How much of the run has passed, in [0, 1], by which rates, weights and resolution go; that of ``index`` of
            ``optimizer.steps`` where nothing is said.
        """
        settings = self.settings
        if progress is None:
            progress = index / max(1, settings.optimizer.steps)
        resolution = resolution_at(progress, settings.optimizer.resolution)
        batch = settings.optimizer.batch
        if self.pool.resolution != resolution:
            # What is never renewed is there whole from the first step on.
            renewed = REFRESH_EVERY * settings.reference.refresh or self.pool.capacity
            self.pool.grow(max(2 * batch, renewed), resolution)
        elif index % REFRESH_EVERY == 0:
            self.pool.grow(REFRESH_EVERY * settings.reference.refresh, resolution)
        ambient = self.ambient.leaf()
        own = (settings.seed * 1_000_003 + index * 7919) & 0xFFFFFFFF
        seed, film_seed = dr.opaque(mi.UInt32, own), dr.opaque(mi.UInt32, self.samples.seed(own))
        factor = self.caution * exponential(progress, settings.optimizer.decay)
        if self._keeps:
            return self._kept_step(ambient, seed, factor)
        views, reference, residual = self.pool.batch(batch)

        self._cut(settings.opacity.steepness**progress)
        pose = self.shape.pose(views)
        renderer = self._renderer(progress)
        renderer.move(dr.detach(pose.positions))
        surface = self.latent.evaluate(pose.positions, pose.base, pose.parameters, views)
        lit = views.under(ambient)
        frame = renderer.render(surface, self.latent.textures, lit, spp=self.samples.spp, seed=film_seed)

        background = self.background(dr.width(frame.image), seed)
        loss, grad_image = frame_loss(frame.image + residual, reference, background, self.loss, self.coverage)
        texel_grad = renderer.backward(
            frame, grad_image, surface, self.latent.textures, pose.positions, seed ^ dr.opaque(mi.UInt32, 0x5BD1E995)
        )
        del frame  # its graph holds on to the textures, which then could not be written in place
        if dr.grad_enabled(pose.base) and settings.loss.laplacian.weight > 0:
            dr.backward(self.laplacian.loss(pose.base) * self._laplacian_weight(loss, progress))
        if texel_grad is not None:
            self.texels.step(texel_grad, dr.opaque(mi.Float, factor))
        self.shape.step(pose, factor)
        self.ambient.step(ambient, factor)
        return loss

    def _kept_step(self, ambient: mi.Float | None, seed: mi.UInt32, factor: float) -> mi.Float:
        """A step of what keeps its hits: shading, loss, the way back, Adam."""
        number, views, reference = self.pool.fixed_batch(self.settings.optimizer.batch)
        if number not in self._kept or self._kept[number].views is not views:
            self._kept = {k: step for k, step in self._kept.items() if step.views is not views and k != number}
            self._kept[number] = KeptStep(self, views, reference)
        loss, grad_image = self._kept[number].run(ambient, seed)
        found = self._kept[number].gradient(ambient, grad_image)
        if found is not None:
            self.texels.step_some(*found, dr.opaque(mi.Float, factor))
        self.ambient.step(ambient, factor)
        return loss

    def _renderer(self, progress: float) -> DeferredRenderer:
        """What a step renders with; all that is judged is rendered exactly."""
        soft = self._soft is not None and progress < self.settings.optimizer.hard_soft.until
        return self._soft if soft and self._soft is not None else self.renderer

    def _cut(self, steepness: float) -> None:
        """How steeply a mask is cut from now on."""
        if self.first_guess.alpha_mode == "MASK":
            self.latent.textures.steepness = dr.opaque(mi.Float, steepness)

    def _laplacian_weight(self, loss: mi.Float, progress: float) -> mi.Float:
        laplacian = self.settings.loss.laplacian
        if self._laplacian_start is None:
            self._laplacian_start = laplacian.weight * float(loss[0]) / max(self.laplacian.absolute_start, 1e-12)
        return dr.opaque(mi.Float, self._laplacian_start * laplacian_weight(progress, laplacian.decay_to))

    def background(self, n: int, seed: mi.UInt32) -> mi.Color3f:
        if self.settings.views.background == "black":
            return mi.Color3f(0)
        pixel = dr.arange(mi.UInt32, n)
        a, b = mi.sample_tea_32(pixel, seed + 17, 6)
        c, _ = mi.sample_tea_32(pixel, seed + 18, 6)
        return mi.Color3f(*(mi.Float(x) * 2.0**-32 for x in (a, b, c)))

    def _moved(self, views: Views) -> tuple[mi.Float, Surface]:
        """The current shape as views of one frame show it, which the renderer then holds."""
        with dr.suspend_grad():
            pose = self.shape.still(views)
            self.renderer.move(pose.positions)
            return pose.positions, self.latent.evaluate(pose.positions, pose.base, pose.parameters, views)

    def _state(self, views: Views) -> tuple[Model, Surface, Textures]:
        positions, surface = self._moved(views)
        return self.latent.as_rendered(positions.numpy(), surface), surface, self.latent.textures

    def _look(self, views: Views) -> np.ndarray:
        """The current state from some views, shape (B, H, W, 4), without what the reference alone computes."""
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        self._cut(_STEP)
        unpeeled = 0.0
        for index, part in views.by_shape():
            _, surface = self._moved(part)
            with dr.suspend_grad():
                lit, opaque_seed = part.under(self.ambient.value), dr.opaque(mi.UInt32, LOOK_SEED)
                frame = self.renderer.render(surface, self.latent.textures, lit, spp=LOOK_SPP, seed=opaque_seed)
            out[index] = frame.images()
            unpeeled += 0.0 if frame.unpeeled is None else float(dr.sum(frame.unpeeled)[0])
        self.unpeeled = unpeeled / max(float(out[..., 3].sum()), 1e-12)
        return out

    def look(self) -> np.ndarray:
        """
        The current state from the views that are never fitted, shape (B, H, W, 4).
        """
        return self._look(self.held_out.views)

    def preview(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Reference and current state from the first of the views that are never fitted.

        Returns
        -------
        reference, current : ndarray, shape (1, H, W, 4), float32
            Linear radiance on black, and coverage; lit directly where the fit adds the rest as a constant.
        """
        return self.held_out.images[:1], self._look(self.held_out.views.take(np.arange(1)))

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
        views = self.held_out.views
        image = self._look(views)
        if self.pool.residual is not None:
            image = image + np.nan_to_num(self.pool.residual.render(views, 1))
        background = self.background(image[..., 0].size, dr.opaque(mi.UInt32, 1))
        return self.held_out.measure(image, background, self.loss, self.coverage)

    def model(self) -> Model:
        """
        The current state as a model; what is not optimised is the first guess's own.
        """
        fitted = self.latent.model(*self.shape.values())
        taken = self.first_guess.taking(fitted, self.settings.latent.optimize)
        return replace(taken, ambient=self.ambient.written())

    def parameters(self) -> dict[str, np.ndarray]:
        """
        What is optimised, as copies.
        """
        return {
            **self.shape.parameters(), **self.ambient.parameters(), "data": self.latent.textures.data.numpy().copy()
        }  # fmt: skip

    def take(self, parameters: dict[str, np.ndarray]) -> None:
        """
        Go on from earlier :meth:`parameters`, with nothing remembered of the steps since.
        """
        self.shape.restart(parameters)
        self.texels.restart(parameters["data"])
        self.ambient.restart(parameters)

    def retreat(self, parameters: dict[str, np.ndarray], *, again: bool = False) -> None:
        """
        After steps that led astray: go back to earlier parameters, and on with half the rates; with ``again``, where
        those of the last retreat have brought nothing either, with twice the samples as well.
        """
        self.take(parameters)
        self.caution *= 0.5
        if again:
            spp = max(self.samples.spp, min(_CAREFUL_SPP, 2 * self.samples.spp))
            if spp > self.samples.spp and self.samples.are_shared:
                self.pool.clear()  # its images have seen other places
            self.samples.spp = spp
        if not np.isfinite(self._laplacian_start or 0.0):
            self._laplacian_start = None

    def not_finite(self) -> str | None:
        """
        Which of what is optimised is no longer finite, None where all is well; waits for the device.
        """
        not_finite = self.shape.not_finite() or (None if self.texels.is_finite() else "textures")
        return not_finite or (None if self.ambient.is_finite() else "ambient light")

    def state(self) -> dict:
        """
        All that later steps depend on, as copies: nested dicts of arrays and plain values.
        """
        return {
            "shape": self.shape.state(), "texels": self.texels.state(), "pool": self.pool.state(),
            "ambient": self.ambient.state(), "laplacian_start": self._laplacian_start, "caution": self.caution,
            "spp": self.samples.spp,
        }  # fmt: skip

    def restore(self, state: dict) -> None:
        """
        Inverse of :meth:`state`: the steps that follow are those that would have followed there.
        """
        self.shape.restore(state["shape"])
        self.texels.restore(state["texels"])
        self.pool.restore(state["pool"])
        self.ambient.restore(state.get("ambient", {}))  # of a dict without entries nothing is left
        self._laplacian_start, self.caution, self.samples.spp = (
            state[k] for k in ("laplacian_start", "caution", "spp")
        )


def _by_chance(settings: ViewsSettings) -> Callable[[int, np.random.Generator, int], list[Views]]:
    """Views anywhere around the origin, as ``ViewPool`` draws them."""
    light = settings.light

    def draw(n: int, rng: np.random.Generator, resolution: int) -> list[Views]:
        views = goniometer(
            n, rng, width=resolution, height=resolution, distance=settings.distance, jitter=settings.jitter,
            fov=settings.fov, light_exponent=light.exponent, irradiance=light.irradiance, light_position=light.position,
        )  # fmt: skip
        return [views]

    return draw


#: Steps between two renewals of the pool: fewer, larger ones cost less.
REFRESH_EVERY = 16

#: Steepness of a mask that is judged: nearly what files show.
_STEP = 64.0

#: Samples per pixel up to which they are doubled: few are quicker, but their noise is no longer small beside what is
#: left to gain near the optimum, and a loss that is not quadratic takes it for error.
_CAREFUL_SPP = 8
