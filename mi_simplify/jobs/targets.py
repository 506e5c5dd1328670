"""
What a file is fitted to: photographs with cameras, one image by the file's own camera, another model, a function.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import Config, code_of
from ..errors import AssetError, UserError
from ..formats.captured.read import SUFFIXES, Captured, read_captured, read_image
from ..formats.gltf.stage.cameras import Camera, PointLight, read_stage
from ..formats.load import load_asset
from ..machine.user_code import code_named
from ..model.asset import Asset
from ..model.frame import Frame
from ..model.light.harmonics import constant_environment
from ..scenes.references.fixed import FixedViews, LitViews
from ..scenes.references.images import ImageReference
from ..scenes.references.reference import CallableReference, FramedReference, Reference
from ..scenes.views import Views, goniometer
from ..subjects.subject import reference_for

log = logging.getLogger("mi_simplify")

#: Radiance that an unknown environment starts with.
GREY = 0.8


@dataclass(frozen=True)
class Target:
    """
    What a fit looks at.

    Parameters
    ----------
    reference : Reference
        Of views in the normalised frame.
    n_views : int or None
        Views that there are; None: any.
    side : int or None
        Largest side of its images [pixels], where they have one.
    ambient : ndarray, shape (K, 3), or None
        Light besides the point lights with which the fit begins.
    notes : tuple of str
    asset : Asset, optional
        What is rendered, where that is a model, as it was read.
    """

    reference: Reference
    n_views: int | None
    side: int | None = None
    ambient: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    asset: Asset | None = None


def open_target(
    target: Any, asset: Asset, frame: Frame, config: Config, *, views: int | Views | None, camera: int | str
) -> Target:
    """
    The target that a path, an asset or a function stands for.

    Parameters
    ----------
    target : str, Path, Asset or callable
        A ``transforms.json``; an image, seen by a camera of the asset's file; a model file or an asset, which is
        rendered; ``package.module:function`` or a function of :class:`..scenes.views.Views` to images.
    asset : Asset
        What is fitted, as it was read.
    frame : Frame
    config : Config
    views : int or Views, optional
        How many views of a model or a function are drawn once and for all, or these; None: new ones all the time.
    camera : int or str
        Number or name of the camera for an image.

    Raises
    ------
    AssetError
        It is not there, cannot be read, or does not fit the file.
    """
    cameras, lights, notes = read_stage(asset.source, asset.bounds)
    if len(lights) > 1:
        others = ", ".join(f"'{light.name}'" for light in lights[1:])
        notes.append(f"one point light is shown, '{lights[0].name}'; left out: {others}")
    light = lights[0] if lights else None
    suffix = Path(target).suffix.lower() if isinstance(target, str | Path) else ""
    if suffix == ".json":
        return _captured(read_captured(target), asset, frame, light, notes)
    if suffix and suffix in SUFFIXES:
        return _captured(_one_image(Path(target), asset, cameras, camera), asset, frame, light, notes)
    function = target if callable(target) else None
    if isinstance(target, str) and code_of(target):
        function = code_named(target, "target")
    reference: Reference
    if function is not None:
        reference, shown = FramedReference(CallableReference(function), frame.scale, frame.center), None
    else:
        shown = target if isinstance(target, Asset) else load_asset(target, purpose="target")
        reference = reference_for(frame.normalised(shown), config)
    return replace(_rendered(reference, frame, config, light, asset.ambient, views, notes), asset=shown)


def _one_image(path: Path, asset: Asset, cameras: list[Camera], which: int | str) -> Captured:
    """An image, seen by one of the file's cameras."""
    if not cameras:
        raise AssetError(
            f"{asset.name} has no perspective camera that could have seen '{path.name}'; add one to the file, or name "
            "a transforms.json"
        )
    known = {str(k): c for k, c in enumerate(cameras)} | {c.name: c for c in cameras}
    if str(which) not in known:
        raise AssetError(f"{asset.name} has no camera '{which}'; its cameras are {', '.join(c.name for c in cameras)}")
    camera = known[str(which)]
    if not path.is_file():
        raise AssetError(f"the target '{path}' does not exist")
    return read_image(path, camera.to_world, camera.yfov, camera.aspect)


def _captured(captured: Captured, asset: Asset, frame: Frame, light: PointLight | None, notes: list[str]) -> Target:
    """Images in the light that they say, else in that of the file, else in an unknown environment."""
    ambient = asset.ambient
    if captured.light_position is None and captured.light == "unlit":
        ambient = np.ones((1, 3), np.float32)
    elif captured.light_position is None and light is not None:
        n = len(captured)
        captured = replace(
            captured, light_position=np.tile(light.position, (n, 1)), light_intensity=np.tile(light.intensity, (n, 1))
        )
    elif captured.light_position is None and ambient is None:
        ambient = constant_environment((GREY, GREY, GREY))
        notes.append("no light is known: it is grey from everywhere, until 'environment' is fitted, too")
    every = list(range(len(captured)))
    reference = ImageReference(captured, frame.scale, frame.center, every, every)
    side = max(max(image.shape[:2]) for image in captured.images)
    return Target(reference, len(every), side, ambient, tuple(notes))


def _rendered(
    reference: Reference, frame: Frame, config: Config, light: PointLight | None, ambient: np.ndarray | None,
    views: int | Views | None, notes: list[str],
) -> Target:  # fmt: skip
    """A renderer, looked at from fixed views or from new ones all the time."""
    place = None
    if light is not None:
        place = (light.position - frame.center) * frame.scale, light.intensity * frame.scale**2
    settings = config.views

    def draw(n: int, rng: np.random.Generator, resolution: int) -> Views:
        drawn = goniometer(
            n, rng, width=resolution, height=resolution, distance=settings.distance, jitter=settings.jitter,
            fov=settings.fov, light_exponent=settings.light.exponent, irradiance=settings.light.irradiance,
            light_position=settings.light.position,
        )  # fmt: skip
        return drawn if place is None else drawn.lit_by_point(*place)

    if ambient is not None:
        notes.append("the ambient light of the file is shown as well")
    if views is None:
        return Target(LitViews(reference, draw, config.seed + 1), None, None, ambient, tuple(notes))
    if isinstance(views, int):
        if views < 1:
            raise UserError(f"views: at least one is needed, got {views}")
        views = draw(views, np.random.default_rng(config.seed), 256)
    else:
        arrays = views.arrays()
        moved = {name: (arrays[name] - frame.center) * frame.scale for name in ("origin", "light_position")}
        moved["light_intensity"] = arrays["light_intensity"] * frame.scale**2
        views = Views.from_arrays(arrays | moved, views.width, views.height)
    return Target(FixedViews(reference, views), len(views), None, ambient, tuple(notes))
