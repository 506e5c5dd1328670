"""
Poses, scale, weights, textures and light of a morphable face, all at once (Takimoto et al. 2022, supplement, Sect.
2.3).

Minimised is their Eq. 2, L = w_l L_l + w_d L_d + w_c L_c + w_r L_r: L1 of landmarks, truncated L1 of depth, L2 of
colour, and squares of the weights and of the texels' distance from their start. Coverage is added where images have a
mask, and light is fitted in spherical harmonics unless its rate is 0; textures have Adam, as everything else, and not
SGD.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ...config.commands.face import FaceSettings
from ...integrators.camera import Cameras
from ...integrators.deferred import DeferredRenderer
from ...latent.footprint import BLOCK
from ...latent.latent import Latent
from ...latent.morphing import MorphedModel
from ...latent.texel_gradient import TexelGradient
from ...machine.upload import upload
from ...model.model import Model
from ...scenes.views import Views
from ..losses import frame_loss, l2
from ..parameters.ambient import AmbientSteps
from ..parameters.shape import ShapeSteps
from ..parameters.texels import TexelAdam
from ..schedules import exponential
from .landmarks import LandmarkFit
from .losses import DepthLoss, LandmarkLoss
from .poses import PoseSteps


@dataclass(frozen=True)
class FaceTargets:
    """
    Portraits on one square film.

    Parameters
    ----------
    images : ndarray, shape (B, S, S, 4)
        Linear radiance on black, and coverage; NaN where the image does not reach.
    landmarks : ndarray, shape (B, L, 2)
        [pixels of the film]
    depth : ndarray, shape (B, S, S), or None
        NaN where it is not known.
    tan : float
        Tangent of half the film's field of view.
    masked : bool
        Whether coverage means anything.
    """

    images: np.ndarray
    landmarks: np.ndarray
    depth: np.ndarray | None
    tan: float
    masked: bool


class FaceFit:
    """
    A fit under way.

    Parameters
    ----------
    model : MorphedModel
        In the normalised frame, at weights of 0, with the light that it starts under.
    landmarks : ndarray, shape (L,)
        Positions of its mesh.
    targets : FaceTargets
    start : LandmarkFit
        What landmarks alone say, in the normalised frame.
    settings : FaceSettings
    """

    def __init__(
        self,
        model: MorphedModel,
        landmarks: np.ndarray,
        targets: FaceTargets,
        start: LandmarkFit,
        settings: FaceSettings,
    ):
        self.settings, rates = settings, settings.rates
        self._model = model
        self.latent = Latent(model.moved_to(start.weights))
        self.renderer = DeferredRenderer(self.latent.topology, shade="pixel", edge_fraction=0.05)
        self.shape = ShapeSteps(self.latent.operation, {"weights"}, {"vertices": 0.0, "weights": rates.weights}, 0.0)
        textures = self.latent.textures
        self.texels = TexelAdam(
            textures,
            {"base_color": rates.base_color, "normal": rates.normal, "roughness": rates.specular,
             "metallic": rates.specular},
            0.1,
        )  # fmt: skip
        self._texels_start = upload(mi.Float, textures.data.numpy())
        self.ambient = AmbientSteps(model.ambient, rates.light > 0, rates.light)
        resolution = targets.images.shape[1]
        self.poses = PoseSteps(
            start.rotations, start.translations / start.scale, start.scale, targets.tan, resolution, rates.pose,
            rates.scale if targets.depth is not None else 0.0,
        )  # fmt: skip
        flat = targets.images.reshape(-1, 4)
        self._target = upload(mi.Vector4f, flat)
        # What is behind the head is there behind the model, too: only what the model covers is compared.
        self._behind = upload(mi.Color3f, np.nan_to_num(flat[:, :3]))
        self._coverage = dr.opaque(mi.Float, settings.loss.coverage if targets.masked else 0.0)
        self._landmarks = LandmarkLoss(landmarks, targets.landmarks)
        self._depth = None
        if targets.depth is not None:
            self._depth = DepthLoss(targets.depth, start.scale, settings.loss.truncation)
        self._weigh = {name: dr.opaque(mi.Float, value) for name, value in settings.loss.model_dump().items()}
        self.done = 0

    def step(self) -> dict[str, mi.Float]:
        """
        One step; returns the terms of the loss without their weights, width 1 each, not read back.
        """
        settings, weigh = self.settings, self._weigh
        seed = dr.opaque(mi.UInt32, (settings.seed * 1_000_003 + self.done * 7919) & 0xFFFFFFFF)
        factor = exponential(self.done / max(1, settings.steps), settings.decay)
        leaves, ambient = self.poses.leaves(), self.ambient.leaf()
        views = self.poses.views(leaves)
        pose = self.shape.pose(views)
        self.renderer.move(dr.detach(pose.positions))
        terms = self._shape_terms(leaves, pose.positions, pose.parameters["weights"])
        dr.backward(sum((weigh[name] * term for name, term in terms.items()), mi.Float(0)))

        surface, textures = self.latent.evaluate(pose.positions), self.latent.textures
        frame = self.renderer.render(surface, textures, views.under(ambient), spp=settings.spp, seed=seed)
        loss, grad = frame_loss(frame.image, self._target, self._behind, l2, self._coverage)
        grad *= weigh["color"]
        by_texels = self.renderer.backward(
            frame, grad, surface, textures, pose.positions, seed ^ dr.opaque(mi.UInt32, 0x5BD1E995)
        )
        del frame  # its graph holds on to the textures
        if by_texels is not None:
            self.texels.step(self._regularised(by_texels, dr.width(grad)), dr.opaque(mi.Float, factor))
        self.shape.step(pose, factor)
        self.poses.step(leaves, factor)
        self.ambient.step(ambient, factor)
        self.done += 1
        return {**{name: dr.detach(term) for name, term in terms.items()}, "color": loss}

    def _shape_terms(self, leaves: dict[str, mi.Float], positions: mi.Float, weights: mi.Float) -> dict[str, mi.Float]:
        """What does not need a picture: landmarks, depth, squares of the weights."""
        cameras = Cameras.of(self.poses.views(leaves))
        terms = {"landmarks": self._landmarks(positions, cameras), "weights": dr.mean(dr.square(weights))}
        if self._depth is not None:
            surface, scale = self.latent.evaluate(positions), self.poses.scale(leaves)
            terms["depth"] = self._depth(self.renderer.tracer.scene, surface, cameras, scale)
        return terms

    def _regularised(self, grad: TexelGradient, n_pixels: int) -> TexelGradient:
        """With the derivative of the texels' squared distance from their start; a texel counts as a pixel does."""
        data, span = self.latent.textures.data, BLOCK * self.latent.textures.n_channels
        lane = dr.arange(mi.UInt32, dr.width(grad.blocks) * span)
        block = lane // span
        place = dr.gather(mi.UInt32, grad.blocks, block) * span + (lane - block * span)
        off = dr.gather(mi.Float, data, place) - dr.gather(mi.Float, self._texels_start, place)
        own = dr.gather(mi.Float, grad.values, lane)
        # What no pixel reads has no derivative at all, and stays.
        off = dr.select(own != 0, off * (self._weigh["textures"] * (2 / n_pixels)), 0)
        values = own + off
        dr.eval(values)
        return TexelGradient(grad.blocks, values)

    def render(self, views: Views, spp: int = 16) -> np.ndarray:
        """
        The face as it is now, shape (B, H, W, 4): linear radiance on black, and coverage.
        """
        with dr.suspend_grad():
            pose = self.shape.still(views)
            self.renderer.move(pose.positions)
            surface = self.latent.evaluate(pose.positions)
            lit, seed = views.under(self.ambient.value), dr.opaque(mi.UInt32, 1)
            return self.renderer.render(surface, self.latent.textures, lit, spp=spp, seed=seed).images()

    def model(self) -> Model:
        """The face as it is now, in the normalised frame, with all of its morph targets."""
        return replace(self.latent.model(*self.shape.values()), ambient=self.ambient.written())
