"""
What the latent model is fitted to: anything that turns views into images.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

import mitsuba as mi
import numpy as np

from ..errors import AssetError, UserError
from .asset import Asset
from .shapes import asset_shapes
from .views import Views

log = logging.getLogger("mi_simplify")

#: What the reference images contain, see DESIGN "Transport" and docs/how-it-works.md.
TRANSPORTS = ("direct", "baked", "matched")


class Reference(Protocol):
    """
    A black box: the only thing that crosses from it to the latent model while fitting is images.
    """

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        Images of the views.

        Returns
        -------
        ndarray, shape (B, height, width, 4), float32
            Linear radiance on black (premultiplied by coverage), and coverage.
        """
        ...


def view_sensor(arrays: dict[str, np.ndarray], k: int, width: int, height: int) -> dict:
    """
    Mitsuba sensor of view ``k`` of ``Views.arrays()``.
    """
    origin, forward, up = (arrays[name][k].astype(np.float64) for name in ("origin", "forward", "up"))
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(arrays["tan_x"][k]))),
        "near_clip": 1e-3,
        "to_world": mi.ScalarTransform4f().look_at(origin.tolist(), (origin + forward).tolist(), up.tolist()),
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba",
            "component_format": "float32", "rfilter": {"type": "box"},
        },
    }  # fmt: skip


class MitsubaReference:
    """
    Any Mitsuba scene, rendered by any of its integrators under the views' point lights.

    Parameters
    ----------
    shapes : dict
        Shapes (and emitters that stay, such as an environment) for ``mi.load_dict``.
    integrator : dict
        Mitsuba integrator.
    spp : int
        Samples per pixel.
    """

    def __init__(self, shapes: dict, integrator: dict, spp: int):
        self.shapes, self.integrator, self.spp = shapes, integrator, spp
        self._scene: mi.Scene | None = None
        self._film = (0, 0)

    def _prepare(self, arrays: dict[str, np.ndarray], width: int, height: int) -> None:
        if self._scene is not None and self._film == (width, height):
            return
        light = {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
        scene = {"type": "scene", "integrator": self.integrator, "view_sensor": view_sensor(arrays, 0, width, height)}
        self._scene = mi.load_dict(scene | {"view_light": light} | self.shapes, optimize=False)
        self._film = (width, height)
        self._params = mi.traverse(self._scene)
        self._params.keep(
            ["view_sensor.to_world", "view_sensor.x_fov", "view_light.position", "view_light.intensity.value"]
        )

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`Reference`; one kernel, launched once a view.
        """
        arrays = views.arrays()
        self._prepare(arrays, views.width, views.height)
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        for k in range(len(views)):
            sensor = view_sensor(arrays, k, views.width, views.height)
            self._params["view_sensor.to_world"] = mi.Transform4f(sensor["to_world"])
            self._params["view_sensor.x_fov"] = mi.Float(sensor["fov"])
            self._params["view_light.position"] = mi.Point3f(arrays["light_position"][k])
            self._params["view_light.intensity.value"] = mi.Color3f(arrays["light_intensity"][k])
            self._params.update()
            out[k] = mi.render(self._scene, spp=self.spp, seed=(seed * len(views) + k) % 2**32).numpy()
        return out


class CallableReference:
    """
    A Python function ``f(views) -> (B, H, W, 4)`` as a reference.
    """

    def __init__(self, function: Callable[[Views], np.ndarray]):
        self.function = function

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`Reference`; checks what the function returns.
        """
        images = np.asarray(self.function(views), np.float32)
        expected = (len(views), views.height, views.width, 4)
        if images.shape != expected:
            raise UserError(f"the reference function returned shape {images.shape}, expected {expected}: (B, H, W, RGBA)")
        if not np.isfinite(images).all():
            raise UserError("the reference function returned NaN or infinite radiance")
        return images


def _integrator(transport: str, max_depth: int, transparent: bool) -> dict:
    if transport not in TRANSPORTS:
        raise UserError(f"unknown transport '{transport}': expected one of {', '.join(TRANSPORTS)}")
    if transport == "direct":
        return {"type": "direct_edge", "layers": 8 if transparent else 1}
    # `path` lets masked surfaces cast full shadows; `volpath` attenuates shadow rays by their opacity.
    return {"type": "volpath" if transparent else "path", "max_depth": max_depth, "hide_emitters": True}


def make_reference(
    asset: Asset, *, transport: str = "direct", spp: int = 32, max_depth: int = 6, sky: float = 0.0, form: str = "gltf"
) -> MitsubaReference:
    """
    The reference renderer of an asset.

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
    form : {'gltf', 'paper'}
        Mixing of the lobes in ``ggx_gamma``.
    """
    transparent = any(p.material.alpha_mode != "OPAQUE" for p in asset.parts)
    shapes = dict(asset_shapes(asset, form=form))
    if sky > 0:
        shapes["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [sky] * 3}}
    return MitsubaReference(shapes, _integrator(transport, max_depth, transparent), spp)


def scene_reference(path: str, *, transport: str = "baked", spp: int = 32, max_depth: int = 6) -> MitsubaReference:
    """
    The shapes of a Mitsuba XML scene as a reference; its sensors, integrator and lights, shapes that emit too, stay out.
    """
    try:
        scene = mi.load_file(str(path), optimize=False)
    except Exception as error:  # Mitsuba raises plain RuntimeError for everything
        raise AssetError(f"{path}: Mitsuba cannot load this scene: {str(error).splitlines()[0]}") from error
    lit = [shape for shape in scene.shapes() if not shape.is_emitter()]
    if len(lit) < len(scene.shapes()):
        log.warning("%s: %d shapes are area lights and stay out", path, len(scene.shapes()) - len(lit))
    shapes = {f"shape_{k}": shape for k, shape in enumerate(lit)}
    if not shapes:
        raise AssetError(f"{path}: the scene has no shapes")
    return MitsubaReference(shapes, _integrator(transport, max_depth, True), spp)
