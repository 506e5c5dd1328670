"""
The subject of a job: a model file here, and what stands in for one in the modules beside this.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..config import SAMPLE_PREFIX, Config, code_of
from ..errors import AssetError
from ..frame import Frame
from ..initial import first_guess, quadrics_only
from ..latent.harmonics import constant_environment
from ..latent.model import Model
from ..progress import ProgressCallback
from ..report.evaluate import Comparison, compare_assets
from ..scenes.asset import Asset
from ..scenes.load import load_asset
from ..scenes.read_mitsuba import SceneAsset
from ..scenes.reference import Reference, make_reference
from ..scenes.samples import sample_asset
from ..scenes.views import Views


class Subject:
    """
    What is simplified: here an asset, which is rendered by Mitsuba and judged by path tracing.

    Everything that a job knows of its input. Another kind of input is another subclass, in a module of its own, that
    :func:`open_subject` knows by its name.

    Parameters
    ----------
    config : Config
    geometry : Asset
        What the first guess is made from, in the units of the input; its box is that of the subject.

    Attributes
    ----------
    config : Config
        What was asked for, completed by what the subject knows of itself.
    frame : Frame
        The normalised frame, in which it is fitted.
    """

    def __init__(self, config: Config, geometry: Asset):
        self.config, self.geometry = config, geometry
        self.frame = Frame.around(geometry.bounds)

    @property
    def shown(self) -> Asset | None:
        """What stands for the subject where reports show it in 3D; None where there is nothing to show."""
        return self.geometry

    def guess(self) -> tuple[Model, list[str]]:
        """
        The first guess that the configuration asks for, in the normalised frame, and notes on it.
        """
        initial, frame = self.config.initial, self.frame
        asset = frame.normalised(self.geometry if initial.source is None else load_asset(initial.source))
        if initial.kind in ("decimate", "cards") and isinstance(asset, SceneAsset):
            asset.require_triangles()
        model, notes = first_guess(
            asset,
            triangles=initial.triangles,
            atlas_size=initial.atlas_size,
            textures=initial.textures,
            kind=initial.kind,
            init=None if initial.mesh is None else frame.normalised(load_asset(initial.mesh, purpose="low-poly mesh")),
            keep_uv=initial.keep_uv,
            repair=initial.repair and "vertices" in self.config.latent.optimize,
            oversample=initial.oversample,
            subdivisions=initial.subdivisions,
            seed=self.config.seed,
            crease_angle=initial.crease_angle,
            output=self.config.opacity.cards,
        )
        return replace(model, ambient=self.ambient), notes

    @property
    def ambient(self) -> np.ndarray | None:
        """Where the ambient light of the latent model starts, shape (K, 3); None where it has none."""
        ambient = self.config.latent.ambient
        if ambient.kind == "environment":
            return constant_environment(ambient.color)
        return np.array([ambient.color], np.float32) if ambient.kind == "color" else None

    def baseline(self, triangles: int) -> Model:
        """
        What a user would take instead, in the normalised frame: see :func:`mi_simplify.initial.quadrics_only`.
        """
        target = self.frame.normalised(self.geometry)
        return quadrics_only(target, triangles, atlas_size=self.config.initial.atlas_size)[0]

    def reference(self) -> Reference:
        """
        The renderer of the target images that the configuration asks for, of views in the normalised frame.
        """
        return reference_for(self.frame.normalised(self.geometry), self.config)

    def lit_as_fitted(self, views: Views) -> Views:
        """
        Views in the units of the input under the static light of the configuration, where it has one.
        """
        light = self.config.views.light
        if light.position is None:
            return views
        place = np.asarray(light.position) / self.frame.scale + self.frame.center
        return views.lit_from(place, self.frame.center, light.irradiance)

    def judge(
        self,
        candidates: Mapping[str, Asset],
        *,
        n_views: int = 8,
        resolution: int = 256,
        spp: int = 64,
        seed: int = 0,
        progress: ProgressCallback | None = None,
    ) -> Comparison:
        """
        Compare candidates with the subject on views that no fit has seen.

        Parameters
        ----------
        candidates : mapping of str to Asset
            In the units of the input.
        n_views, resolution, spp, seed, progress
            As in :func:`mi_simplify.report.compare_assets`.
        """
        return compare_assets(
            self.geometry, candidates, n_views=n_views, resolution=resolution, spp=spp, seed=seed, progress=progress
        )


def open_asset(name: str) -> Asset:
    """
    A model file, or the procedural sample that ``sample:NAME`` stands for.
    """
    if name.startswith(SAMPLE_PREFIX):
        return sample_asset(name.removeprefix(SAMPLE_PREFIX))
    return load_asset(name)


def open_subject(config: Config) -> Subject:
    """
    The subject that ``config.asset`` names.

    Raises
    ------
    UserError
        It is not there, cannot be read, or cannot be what the configuration wants it to be.
    """
    name = config.asset
    if name == f"{SAMPLE_PREFIX}creature" or code_of(name):
        from .implicit import ImplicitSubject

        return ImplicitSubject(config)
    if Path(name).suffix.lower() == ".json":
        from .images import ImageSubject

        return ImageSubject(config)
    geometry = open_asset(name)
    if config.reference.renderer != "mitsuba" or config.reference.command is not None:
        from .external import ExternalSubject

        return ExternalSubject(config, geometry)
    if geometry.rig is not None:
        from .character import Character

        return Character(config, geometry)
    return Subject(config, geometry)


def reference_for(asset: Asset, config: Config) -> Reference:
    """
    Mitsuba's rendering of an asset, as the configuration asks for it.
    """
    settings = config.reference
    if settings.environment is not None and not Path(settings.environment).is_file():
        raise AssetError(f"the environment map '{settings.environment}' does not exist")
    return make_reference(
        asset, transport=settings.transport, spp=settings.spp, max_depth=settings.max_depth,
        environment=settings.environment, lights=settings.scene_lights, form=config.latent.shading,
    )  # fmt: skip
