"""
Assets and Mitsuba scenes as references: which integrator renders them, and in which light.
"""

from __future__ import annotations

import logging
from functools import partial

import mitsuba as mi
import numpy as np

from ...config.schema import ReferenceSettings
from ...errors import AssetError, UserError
from ...formats.mitsuba.file import Node, SceneFile
from ...formats.mitsuba.read import SceneAsset, is_emitting
from ...model.asset import Asset
from ...model.groups import is_see_through
from ..shapes import asset_shapes
from .animated import AnimatedReference
from .direct import DirectReference
from .mitsuba import MitsubaReference
from .reference import FramedReference, Reference

log = logging.getLogger("mi_simplify")

#: What the configuration has where nothing is said.
_DEFAULTS = ReferenceSettings()

#: What the reference images contain, see docs/how-it-works.md.
TRANSPORTS = ("direct", "baked", "matched")


def _integrator(transport: str, max_depth: int, transparent: bool) -> dict:
    """
    Mitsuba's integrator of a transport, see :func:`make_reference`.
    """
    if transport not in TRANSPORTS:
        raise UserError(f"unknown transport '{transport}': expected one of {', '.join(TRANSPORTS)}")
    if transport == "direct":
        return {"type": "direct_edge", "layers": 8 if transparent else 1}
    # `path` lets masked surfaces cast full shadows; `volpath` attenuates shadow rays by their opacity.
    return {"type": "volpath" if transparent else "path", "max_depth": max_depth, "hide_emitters": True}


def make_reference(
    asset: Asset,
    *,
    transport: str = "direct",
    spp: int = _DEFAULTS.samples,
    max_depth: int = _DEFAULTS.max_depth,
    sky: float = 0.0,
    environment: str | None = None,
    lights: bool = False,
    form: str = "gltf",
    ambient: np.ndarray | None = None,
    emission: bool = True,
) -> Reference:
    """
    The reference renderer of an asset; that of a Mitsuba scene renders the scene itself, that of a character poses it.

    Parameters
    ----------
    asset : Asset
    transport : {'direct', 'baked', 'matched'}
        'direct' holds the renderer to direct light without shadows; the others path trace.
    spp : int
        Samples per pixel.
    max_depth : int
        Longest path, where paths are traced.
    sky : float
        Radiance of a constant environment, 0 for none.
    environment : str, optional
        Image file of an environment.
    lights : bool
        Whether a Mitsuba scene keeps its own lights, see :func:`scene_reference`.
    form : {'gltf', 'paper'}
        Mixing of the lobes in ``ggx_gamma``.
    ambient : ndarray, shape (1, 3), optional
        Light from everywhere; only with 'direct', as in the latent model.
    emission : bool
        Show the light that surfaces give off by themselves; the latent model has none.
    """
    if isinstance(asset, SceneAsset):
        reference = scene_reference(asset.file, transport=transport, spp=spp, max_depth=max_depth, lights=lights)
    else:
        integrator = _integrator(transport, max_depth, any(is_see_through(p) for p in asset.parts))
        if ambient is not None:
            integrator["ambient"] = mi.ScalarVector3f(*(float(x) for x in ambient[0]))
        glows = emission and any(p.material.emission is not None for p in asset.parts)
        only_views = sky == 0 and environment is None
        make = partial(_renderer, integrator=integrator, spp=spp, glows=glows, only_views=only_views)
        if asset.rig is not None:
            animated = AnimatedReference(asset, make, form)
            animated.reference.light_up(sky, environment)
            return animated
        reference = make(dict(asset_shapes(asset, form=form)))
    own = [name for name, o in reference.shapes.items() if isinstance(o, mi.Emitter) and o.is_environment()]
    if own and (sky > 0 or environment is not None):
        raise UserError(f"{asset.source}: a scene with an environment of its own takes no other; leave one out")
    reference.light_up(sky, environment)
    return FramedReference(reference, asset.scale, asset.center) if isinstance(asset, SceneAsset) else reference


def _renderer(shapes: dict, *, integrator: dict, spp: int, glows: bool = False, only_views: bool) -> MitsubaReference:
    """
    What renders some shapes with an integrator, lit by the views alone or by more.
    """
    if integrator["type"] == "direct_edge" and only_views:
        return DirectReference(shapes, integrator, spp, glows)
    return MitsubaReference(shapes, integrator, spp, glows)


def scene_reference(
    scene: str | SceneFile,
    *,
    transport: str = "baked",
    spp: int = _DEFAULTS.samples,
    max_depth: int = _DEFAULTS.max_depth,
    lights: bool = False,
) -> MitsubaReference:
    """
    The shapes of a Mitsuba XML scene as a reference, in its own units; its sensors and integrator stay out.

    Parameters
    ----------
    scene : str or SceneFile
    transport, spp, max_depth
        As in :func:`make_reference`.
    lights : bool
        Whether emitters and emitting shapes light it, in addition to the light of the views; they are not seen.

    Raises
    ------
    AssetError
        Mitsuba cannot load the scene, or it has no shapes.
    """
    file = scene if isinstance(scene, SceneFile) else SceneFile(scene)
    lit = [shape for shape in file.shapes if lights or not is_emitting(shape)]
    if not any(shape.plugin != "shapegroup" and not is_emitting(shape) for shape in lit):
        raise AssetError(f"{file.path.name}: the scene has no shapes but lights")
    if len(lit) < len(file.shapes) and file is not scene:  # of a file read before, its reader has told so
        log.warning("%s: %d shapes are area lights and stay out", file.path.name, len(file.shapes) - len(lit))
    # Emitters know the scene that they are in, so they cannot be shared with another one.
    shapes = {f"shape_{k}": file.make(shape, fresh=is_emitting(shape)) for k, shape in enumerate(lit)}
    emitters = {f"emitter_{k}": file.make(e, fresh=True) for k, e in enumerate(file.emitters if lights else ())}
    integrator = _integrator(transport, max_depth, _see_through(file, lit))
    return _renderer(shapes | emitters, integrator=integrator, spp=spp, only_views=not lights)


def _see_through(file: SceneFile, shapes: list[Node]) -> bool:
    """
    Whether rays pass straight through anything: masks, the borders of media, and lamps, of which `path` with
    ``hide_emitters`` shows the black silhouettes.
    """
    for shape in shapes:
        members = shape.of_kind("Shape")  # of a group; of an instance: the group
        if members and _see_through(file, members):
            return True
        if shape.of_kind("Medium") or is_emitting(shape):
            return True
        bsdf = None if members else file.make(shape).bsdf()
        if bsdf is not None and mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null):
            return True
    return False
