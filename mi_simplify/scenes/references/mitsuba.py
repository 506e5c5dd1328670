"""
Mitsuba as the reference: assets and scenes under the lights of the views.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from ...machine.upload import upload
from ..views import Views

log = logging.getLogger("mi_simplify")


def view_sensor(arrays: dict[str, np.ndarray], k: int, width: int, height: int) -> dict:
    """
    Mitsuba sensor of view ``k`` of ``Views.arrays()``.
    """
    origin, forward, up = (arrays[name][k].astype(np.float64) for name in ("origin", "forward", "up"))
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2 * np.arctan(arrays["tan_x"][k]))),
        "near_clip": 1e-6,
        "far_clip": 1e12,  # scenes in millimetres end beyond the 1e4 of the plugin; the ray's origin does not suffer
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
    glows : bool
        Add the emission of materials, see :class:`...integrators.lights.own_light.OwnLight`.
    """

    def __init__(self, shapes: dict, integrator: dict, spp: int, glows: bool = False):
        self.shapes, self.integrator, self.spp = shapes, integrator, spp
        self._own_light = mi.load_dict({"type": "own_light"}) if glows else None
        # One sample in each row, column and cell of a grid, so that 4 have the noise of 16 independent ones; the plugin
        # makes other numbers of samples more, for a grid of its own.
        self.sampler: dict = {"type": "independent" if spp % math.isqrt(spp) else "multijitter"}
        """Mitsuba sampler of the camera, which may be replaced before the first image."""
        self._scene: mi.Scene | None = None
        self._film = (0, 0)
        self._moved: dict[str, np.ndarray] = {}

    def light_up(self, sky: float = 0.0, environment: str | None = None) -> None:
        """
        Add a constant sky of this radiance, or the environment of an image file, before anything is rendered.
        """
        if sky > 0:
            # A path tracer meets it wherever a path leaves the scene; to pick it as one of two lights, at random, would
            # make the other one noisy, which alone is picked then and has no noise where it shines.
            share = 0.0 if self.integrator["type"] in ("path", "volpath") else 1.0
            radiance = {"type": "rgb", "value": [sky] * 3}
            self.shapes["sky"] = {"type": "constant", "radiance": radiance, "sampling_weight": share}
        if environment is not None:
            self.shapes["environment"] = {"type": "envmap", "filename": environment}

    def move(self, values: Mapping[str, np.ndarray]) -> None:
        """
        New values of scene parameters by key, flat, such as those of :func:`...machine.meshes.mesh_keys`.
        """
        self._moved = dict(values)
        if self._scene is not None:
            self._apply_moved()

    def _apply_moved(self) -> None:
        for key, value in self._moved.items():
            self._params[key] = upload(mi.Float, value)
        self._params.update()

    def _prepare(self, arrays: dict[str, np.ndarray], width: int, height: int) -> None:
        if self._scene is not None and self._film == (width, height):
            return
        light = {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
        sensor = view_sensor(arrays, 0, width, height) | {"sampler": self.sampler}
        scene = {"type": "scene", "integrator": self.integrator, "view_sensor": sensor}
        self._scene = mi.load_dict(scene | {"view_light": light} | self.shapes, optimize=False)
        self._film = (width, height)
        self._params = mi.traverse(self._scene)
        views = ["view_sensor.to_world", "view_sensor.x_fov", "view_light.position", "view_light.intensity.value"]
        self._params.keep([*views, *self._moved])
        self._apply_moved()

    def render(self, views: Views, seed: int = 0, spp: int | None = None) -> np.ndarray:
        """
        See :class:`.reference.Reference`; one kernel, launched once a view, with other samples where ``spp`` is given.
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
            samples, number = spp or self.spp, (seed * len(views) + k) % 2**32
            out[k] = mi.render(self._scene, spp=samples, seed=number).numpy()
            if self._own_light is not None:
                glow = mi.render(self._scene, integrator=self._own_light, spp=samples, seed=number).numpy()
                out[k, ..., :3] += glow[..., :3]
        return out
