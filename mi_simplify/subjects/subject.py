"""
The subject of a job: a model file here, and what stands in for one in the modules beside this.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..config import SAMPLE_PREFIX, Config
from ..errors import AssetError
from ..frame import Frame
from ..initial import first_guess
from ..latent.model import Model
from ..report.evaluate import Comparison, compare_assets
from ..scenes.asset import Asset
from ..scenes.load import load_asset
from ..scenes.read_mitsuba import SceneAsset
from ..scenes.reference import Reference, make_reference
from ..scenes.samples import sample_asset


class Subject:
    """
    What is simplified: here an asset, which is rendered by Mitsuba and judged by path tracing.

    Everything that a job knows of its input. Another kind of input is another subclass, in a module of its own, that
    :func:`open_subject` knows by its name.

    Parameters
    ----------
    geometry : Asset
        What the first guess is made from, in the units of the input; its box is that of the subject.
    """

    def __init__(self, geometry: Asset):
        self.geometry = geometry

    @property
    def shown(self) -> Asset | None:
        """What stands for the subject where reports show it in 3D; None where there is nothing to show."""
        return self.geometry

    def guess(self, config: Config, frame: Frame) -> tuple[Model, list[str]]:
        """
        The first guess that the configuration asks for, in ``frame``, and notes on it.
        """
        initial = config.initial
        asset = frame.normalised(self.geometry)
        if initial.kind == "decimate" and isinstance(asset, SceneAsset):
            asset.require_triangles()
        return first_guess(
            asset,
            triangles=initial.triangles,
            atlas_size=initial.atlas_size,
            textures=initial.textures,
            kind=initial.kind,
            init=None if initial.mesh is None else frame.normalised(load_asset(initial.mesh, purpose="low-poly mesh")),
            keep_uv=initial.keep_uv,
            repair=initial.repair and "vertices" in config.latent.optimize,
            seed=config.seed,
            crease_angle=initial.crease_angle,
        )

    def reference(self, config: Config, frame: Frame) -> Reference:
        """
        The renderer of the target images that the configuration asks for, of views in ``frame``.
        """
        return reference_for(frame.normalised(self.geometry), config)

    def judge(self, candidates: Mapping[str, Asset], **settings: Any) -> Comparison:
        """
        Compare candidates, in the units of the input, with the subject on views that no fit has seen.

        Parameters
        ----------
        candidates : mapping of str to Asset
        settings
            ``n_views``, ``resolution``, ``spp``, ``seed`` and ``progress`` of
            :func:`mi_simplify.report.compare_assets`.
        """
        return compare_assets(self.geometry, candidates, **settings)


def open_asset(name: str) -> Asset:
    """
    A model file, or the procedural sample that ``sample:NAME`` stands for.
    """
    if name.startswith(SAMPLE_PREFIX):
        return sample_asset(name.removeprefix(SAMPLE_PREFIX))
    return load_asset(name)


def open_subject(name: str) -> Subject:
    """
    The subject that a name stands for.

    Parameters
    ----------
    name : str
        As ``asset`` in a configuration.
    """
    return Subject(open_asset(name))


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
