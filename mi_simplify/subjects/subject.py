"""
What a job asks of its input, whatever that is.
"""

from __future__ import annotations

import copy
import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..config import SAMPLE_PREFIX, Config
from ..config.initial import LARGEST_ATLAS
from ..config.presets import STARTS
from ..errors import AssetError
from ..formats.images import decode_image
from ..formats.load import load_asset
from ..formats.mitsuba.read import SceneAsset
from ..initial.budget import budget, settled
from ..initial.cards.cards import is_aggregate
from ..initial.guess import first_guess
from ..initial.nodes import kept_nodes, require_no_nodes
from ..initial.quadrics import quadrics_only
from ..judging.comparison import Comparison
from ..judging.evaluate import Judging, Rendering, compare_renderings
from ..judging.kept_pictures import KeptPictures
from ..judging.renderers import half
from ..model.asset import Asset
from ..model.frame import Frame
from ..model.light.environment_map import as_map, resized
from ..model.light.harmonics import constant_environment, environment_coefficients
from ..model.model import Model, VertexSets
from ..progress import ProgressCallback
from ..report.portrait import in_frame, portrait_view, render_picture
from ..scenes.references.path_traced import make_reference
from ..scenes.references.reference import FramedReference, Reference
from ..scenes.samples.catalogue import sample_asset
from ..scenes.views import Views, held_out_views
from .light import fitted_light

log = logging.getLogger("mi_simplify")


class Subject(ABC):
    """
    What is simplified: everything that a job knows of its input.

    Each kind of input is a subclass in a module of its own, which :func:`.registry.register_subject` makes known. What
    is abstract here differs between them; what begins with an underscore is there for them to use.

    Parameters
    ----------
    config : Config
    geometry : Asset
        What the first guess is made from, in the units of the input; its box is that of the subject.

    Attributes
    ----------
    config : Config
        What was asked for, completed by what the subject knows of itself.
    shown : Asset
        What the fit sees of the geometry: of instances of a mesh that stay instances the first.
    frame : Frame
        The normalised frame, in which it is fitted.
    kept : KeptPictures
        Of what is judged by, over all judgements; those of the same input may be shared.
    """

    #: Whether nodes of its file can be kept: it is fitted to a rendering of ``shown``.
    keeps_nodes = False

    def __init__(self, config: Config, geometry: Asset):
        if config.reference.environment is not None and config.latent.ambient.kind == "auto":
            config = with_ambient(config, kind="environment", optimize=False)
        config = config.model_copy(update={"initial": settled(config.initial, geometry)})
        self.config, self.geometry = with_kind(config, geometry), geometry
        kept = kept_nodes(geometry, self.config.initial)
        if kept is not None and not self.keeps_nodes:
            require_no_nodes(self.config.initial)
            initial = self.config.initial.model_copy(update={"keep_nodes": "none"})
            self.config, kept = self.config.model_copy(update={"initial": initial}), None
        self.shown = geometry if kept is None else kept.single
        self.frame, self.kept = Frame.around(self.shown.bounds), KeptPictures()

    @property
    @abstractmethod
    def display(self) -> Asset | None:
        """What stands for the subject where reports show it in 3D; None where there is nothing to show."""

    @abstractmethod
    def guess(self) -> tuple[Model, list[str]]:
        """
        The first guess that the configuration asks for, in the normalised frame, and notes on it.
        """

    @abstractmethod
    def baseline(self, triangles: int) -> Model:
        """
        What a user would take instead, in the normalised frame: see :func:`..initial.quadrics.quadrics_only`.
        """

    @abstractmethod
    def reference(self) -> Reference:
        """
        The renderer of the target images that the configuration asks for, of views in the normalised frame.
        """

    @abstractmethod
    def renderer(self, spp: int) -> Reference:
        """
        What shows the subject as the fit sees it, in the units of the input.
        """

    @abstractmethod
    def facts(self, model: Model) -> dict[str, Any]:
        """
        What ``metrics.json`` tells of a fitted model, in the normalised frame, besides the usual.
        """

    @abstractmethod
    def judge(
        self, candidates: Mapping[str, Asset], judging: Judging = Judging(), progress: ProgressCallback | None = None
    ) -> Comparison:
        """
        Compare candidates with the subject on views that no fit has seen.

        Parameters
        ----------
        candidates : mapping of str to Asset
            In the units of the input.
        judging, progress
            As in :func:`mi_simplify.judging.compare_assets`.
        """

    def under(self, config: Config) -> Self:
        """
        The same subject, not read again, under a configuration that differs in what is not its own.
        """
        other = copy.copy(self)
        other.config = config
        return other

    def _first_guess(self) -> tuple[Model, list[str]]:
        """The first guess from the subject's geometry."""
        initial, frame = self.config.initial, self.frame
        asset = frame.normalised(self.geometry if initial.source is None else load_asset(initial.source))
        if initial.kind in ("decimate", "cards") and isinstance(asset, SceneAsset):
            asset.require_triangles()
        mesh = None if initial.mesh is None else frame.normalised(load_asset(initial.mesh, purpose="low-poly mesh"))
        repair = initial.repair and "vertices" in self.config.latent.optimize
        model, notes = first_guess(
            asset, initial.model_copy(update={"repair": repair}), mesh=mesh, seed=self.config.seed,
            cards=self.config.opacity.cards, resolution=self.config.evaluation.resolution,
        )  # fmt: skip
        if initial.vertex_sets > 1:
            sizes = tuple(float(max(self.config.optimizer.resolution) / 2**k) for k in range(initial.vertex_sets))
            offsets = np.zeros((len(sizes) - 1, *model.mesh.positions.shape))
            model = replace(model, vertex_sets=VertexSets(sizes, offsets))
        return replace(model, ambient=self.ambient), notes

    @property
    def ambient(self) -> np.ndarray | None:
        """Where the ambient light of the latent model starts, shape (K, 3); None where it has none."""
        ambient, known = self.config.latent.ambient, self.config.reference.environment
        if ambient.kind == "environment" and known is not None:
            image = read_environment(known)
            return resized(image, rows).reshape(-1, 3) if (rows := ambient.rows) else environment_coefficients(image)
        if ambient.kind == "environment":
            constant = constant_environment(ambient.color)
            return as_map(constant, ambient.rows) if ambient.rows else constant
        return np.array([ambient.color], np.float32) if ambient.kind == "color" else None

    def _quadrics(self, triangles: int) -> Model:
        """The subject's geometry, decimated by others."""
        target = self.frame.normalised(self.geometry)
        return quadrics_only(target, triangles, atlas_size=self.config.initial.atlas_side)[0]

    def lit_as_fitted(self, views: Views) -> Views:
        """
        Views in the units of the input under the static light of the configuration, where it has one.
        """
        light = self.config.views.light
        if light.position is None:
            return views
        place = np.asarray(light.position) / self.frame.scale + self.frame.center
        return views.lit_from(place, self.frame.center, light.irradiance)

    def picture(self, frame: float | None = None, *, spp: int = 64, **view: Any) -> np.ndarray:
        """
        One picture, shape (H, W, 4), linear: as fitted where only its own renderer can show it, else under a dim sky.

        Parameters
        ----------
        frame : float, optional
            Of its animation.
        spp : int
            Samples per pixel.
        view
            As in :func:`mi_simplify.report.portrait.portrait_view`.
        """
        reference = self.config.reference
        if self.config.evaluation.light == "fitted":
            views = self.lit_as_fitted(portrait_view(self.geometry.bounds, **view))
            return self.renderer(spp).render(views)[0]
        asset, transport = in_frame(self.geometry, frame), reference.transport
        return render_picture(asset, transport=transport, spp=spp, max_depth=reference.max_depth, **view)

    def _framed(self) -> Reference:
        """The subject's own renderer, for views in the normalised frame."""
        return FramedReference(self.renderer(self.config.reference.samples), self.frame.scale, self.frame.center)

    def _judged_in_its_own_light(
        self, candidates: Mapping[str, Asset], judging: Judging, progress: ProgressCallback | None
    ) -> Comparison:
        """Beside images of its own renderer, in the light that was fitted."""
        judging.require_mitsuba()
        views = held_out_views(self.geometry.bounds, judging.n_views, judging.resolution, judging.seed)
        settings = {"spp": judging.spp, "seed": judging.seed}
        return self.compared(
            self.renderer(half(judging.spp)), candidates, self.lit_as_fitted(views), settings, progress
        )

    def compared(
        self,
        renderer: Reference,
        candidates: Mapping[str, Asset],
        views: Views,
        settings: dict,
        progress: ProgressCallback | None,
    ) -> Comparison:
        """
        Candidates in the light that they were fitted to, beside images of a reference renderer.
        """
        settings_used = {"light": "as fitted", "reference": self.config.reference.transport}
        others = {
            name: Rendering(asset, fitted_light(asset, half(settings["spp"]), self.config))
            for name, asset in candidates.items()
        }
        return compare_renderings(Rendering(self.geometry, renderer), others, views, settings_used | settings, progress)


def open_asset(name: str) -> Asset:
    """
    A model file, or the procedural sample that ``sample:NAME`` stands for.
    """
    if name.startswith(SAMPLE_PREFIX):
        return sample_asset(name.removeprefix(SAMPLE_PREFIX))
    asset = load_asset(name)
    for note in asset.notes:  # whatever the command, what it lost is told on the terminal
        log.warning("%s: %s", Path(name).name, note)
    return asset


def with_kind(config: Config, geometry: Asset) -> Config:
    """
    The configuration with ``initial.kind: auto`` decided by the geometry, and what such a start has as defaults.
    """
    if config.initial.kind != "auto":
        return config
    why = is_aggregate(geometry, budget(config.initial))
    log.warning("%s", f"aggregate geometry: {why}: cards" if why else "no aggregate geometry: one surface")
    kind = "cards" if why else "decimate"
    initial = config.initial.model_copy(update={"kind": kind})
    return config.model_copy(update={"initial": initial}).started(STARTS.get(kind, {}))


def with_ambient(config: Config, **changes: Any) -> Config:
    """
    The configuration with other keys in ``latent.ambient``.
    """
    ambient = config.latent.ambient.model_copy(update=changes)
    return config.model_copy(update={"latent": config.latent.model_copy(update={"ambient": ambient})})


def judged_as_fitted(config: Config) -> Config:
    """
    The configuration of a subject that only its own renderer can show, so that it cannot be lit anew by another; nor
    does its geometry tell how fine its look is.
    """
    config = config.started({"initial": {"atlas_size": LARGEST_ATLAS}})
    return config.model_copy(update={"evaluation": config.evaluation.model_copy(update={"light": "fitted"})})


def require_environment(path: str | None) -> None:
    """
    Raise :class:`AssetError` where an environment map is named that does not exist.
    """
    if path is not None and not Path(path).is_file():
        raise AssetError(f"the environment map '{path}' does not exist")


def read_environment(path: str) -> np.ndarray:
    """
    The image of an environment map, shape (H, W, 3), linear.
    """
    require_environment(path)
    image = decode_image(Path(path).read_bytes(), Path(path).name, "reference.environment")
    if image.dtype.kind != "f" or image.shape[2] < 3:
        raise AssetError(f"the environment map '{path}' should be an EXR or HDR image with three channels")
    return image[..., :3]


def renderer_of(asset: Asset, config: Config, spp: int) -> Reference:
    """
    Mitsuba's rendering of an asset in the units of its file, as the configuration asks for it, with so many samples.
    """
    settings = config.reference.model_copy(update={"spp": spp})
    return reference_for(asset, config.model_copy(update={"reference": settings}), emission=True)


def reference_for(asset: Asset, config: Config, *, emission: bool = False) -> Reference:
    """
    Mitsuba's rendering of an asset, as the configuration asks for it; a fit, whose model has no emission, sees none.
    """
    settings = config.reference
    require_environment(settings.environment)
    return make_reference(
        asset, transport=settings.transport, spp=settings.samples, max_depth=settings.max_depth,
        environment=settings.environment, lights=settings.scene_lights, form=config.latent.shading,
        emission=emission,
    )  # fmt: skip
