"""
Mitsuba as the reference: assets and scenes under the lights of the views.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

import mitsuba as mi
import numpy as np

from ..errors import AssetError, UserError
from ..machine.upload import upload
from .asset import Asset
from .mitsuba_file import Node, SceneFile
from .read_mitsuba import SceneAsset, is_emitting
from .reference import FramedReference, Reference
from .shapes import asset_shapes
from .views import Views

log = logging.getLogger("mi_simplify")

#: What the reference images contain, see docs/how-it-works.md.
TRANSPORTS = ("direct", "baked", "matched")


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
    """

    def __init__(self, shapes: dict, integrator: dict, spp: int):
        self.shapes, self.integrator, self.spp = shapes, integrator, spp
        self.sampler: dict = {"type": "independent"}
        """Mitsuba sampler of the camera, which may be replaced before the first image."""
        self._scene: mi.Scene | None = None
        self._film = (0, 0)
        self._moved: dict[str, np.ndarray] = {}

    def light_up(self, sky: float = 0.0, environment: str | None = None) -> None:
        """
        Add a constant sky of this radiance, or the environment of an image file, before anything is rendered.
        """
        if sky > 0:
            self.shapes["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [sky] * 3}}
        if environment is not None:
            self.shapes["environment"] = {"type": "envmap", "filename": environment}

    def move(self, values: Mapping[str, np.ndarray]) -> None:
        """
        New values of scene parameters by key, flat, such as those of :func:`.shapes.mesh_keys`.
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

    def render(self, views: Views, seed: int = 0) -> np.ndarray:
        """
        See :class:`.reference.Reference`; one kernel, launched once a view.
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
    spp: int = 32,
    max_depth: int = 6,
    sky: float = 0.0,
    environment: str | None = None,
    lights: bool = False,
    form: str = "gltf",
    ambient: np.ndarray | None = None,
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
    """
    if isinstance(asset, SceneAsset):
        reference = scene_reference(asset.file, transport=transport, spp=spp, max_depth=max_depth, lights=lights)
    else:
        transparent = any(p.material.alpha_mode != "OPAQUE" for p in asset.parts)
        integrator = _integrator(transport, max_depth, transparent)
        if ambient is not None:
            integrator["ambient"] = mi.ScalarVector3f(*(float(x) for x in ambient[0]))
        if asset.rig is not None:
            from .animated import AnimatedReference

            return AnimatedReference(asset, integrator, spp, sky=sky, environment=environment, form=form)
        reference = MitsubaReference(dict(asset_shapes(asset, form=form)), integrator, spp)
    own = [name for name, o in reference.shapes.items() if isinstance(o, mi.Emitter) and o.is_environment()]
    if own and (sky > 0 or environment is not None):
        raise UserError(f"{asset.source}: a scene with an environment of its own takes no other; leave one out")
    reference.light_up(sky, environment)
    return FramedReference(reference, asset.scale, asset.center) if isinstance(asset, SceneAsset) else reference


def scene_reference(
    scene: str | SceneFile, *, transport: str = "baked", spp: int = 32, max_depth: int = 6, lights: bool = False
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
    return MitsubaReference(shapes | emitters, _integrator(transport, max_depth, _see_through(file, lit)), spp)


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
