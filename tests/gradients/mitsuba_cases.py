"""
Scenes of Mitsuba's own parts that `direct_edge` promises gradients for, by name.
"""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi

from .mitsuba_scene import MitsubaScene, camera

_COLOUR = {"type": "rgb", "value": [0.6, 0.5, 0.4]}
_DIFFUSE = {"type": "diffuse", "reflectance": _COLOUR}


def _floor() -> dict:
    place = mi.ScalarTransform4f
    turned = place().translate([0, -1.0, 0]) @ place().rotate([1, 0, 0], -90) @ place().scale(4)
    return {"floor": {"type": "rectangle", "to_world": turned, "bsdf": {"type": "twosided", "both": _DIFFUSE}}}


def _wall() -> dict:
    return {
        "wall": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0, 0, 2.2]).scale([4, 4, 0.5]),
            "bsdf": _DIFFUSE,
        }
    }


def _batch() -> dict:
    first, second = camera(), camera(fov=30)
    film = camera(film={"width": 80})["film"]
    own = lambda s: {k: v for k, v in s.items() if k not in ("film", "sampler")}  # noqa: E731
    return {"type": "batch", "a": own(first), "b": own(second), "film": film, "sampler": {"type": "multijitter"}}


def _near_light() -> dict:
    return {"type": "point", "position": [1.2, 1.6, -2.8], "intensity": {"type": "rgb", "value": [9.0, 8.0, 7.0]}}


def _sun() -> dict:
    return {
        "type": "directional",
        "direction": [-0.35, -0.45, 1],
        "irradiance": {"type": "rgb", "value": [2, 1.8, 1.5]},
    }


def _cone() -> dict:
    return {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at([1.2, 1.6, -2.8], [0, 0, 0.5], [0, 1, 0]),
        "cutoff_angle": 40,
        "intensity": {"type": "rgb", "value": [12.0, 11.0, 10.0]},
    }


def _shadow(light: dict, receiver: dict) -> MitsubaScene:
    return MitsubaScene(_DIFFUSE, light=light, others=receiver, smooth=False, shadows=True)


_CROP = {"crop_offset_x": 7, "crop_offset_y": 6, "crop_width": 23, "crop_height": 17}
_ROUGH = {"type": "principled", "base_color": _COLOUR, "roughness": 0.6}
_BRIGHT = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 1.5]}}

#: What is tried; building takes an active variant.
CASES: dict[str, Callable[[], MitsubaScene]] = {
    "principled": lambda: MitsubaScene(_ROUGH),
    "diffuse": lambda: MitsubaScene(_DIFFUSE),
    "twosided diffuse": lambda: MitsubaScene({"type": "twosided", "both": _DIFFUSE}),
    "mask over diffuse": lambda: MitsubaScene({"type": "mask", "opacity": 0.6, "nested": _DIFFUSE}),
    "blend": lambda: MitsubaScene({"type": "blendbsdf", "weight": 0.4, "first": _DIFFUSE, "second": _ROUGH}),
    "rectangle beside it": lambda: MitsubaScene(_DIFFUSE, others=_floor()),
    "crop window, Gaussian filter": lambda: MitsubaScene(_DIFFUSE, sensor=camera(rfilter="gaussian", film=_CROP)),
    "sample_border": lambda: MitsubaScene(
        _DIFFUSE, sensor=camera(rfilter="gaussian", film={"sample_border": True}, fov=26)
    ),
    "one-sided emitter": lambda: MitsubaScene(
        {"type": "diffuse", "reflectance": 0.0}, emitter=_BRIGHT, light=False, hide_emitters=False
    ),
    "principal point": lambda: MitsubaScene(
        _DIFFUSE, sensor=camera(principal_point_offset_x=0.1, principal_point_offset_y=-0.15)
    ),
    "orthographic": lambda: MitsubaScene(_DIFFUSE, sensor=camera("orthographic")),
    "thinlens": lambda: MitsubaScene(
        _DIFFUSE, sensor=camera("thinlens", aperture_radius=0.15, focus_distance=2.2), others=_wall()
    ),
    "batch of two": lambda: MitsubaScene(_DIFFUSE, sensor=_batch()),
    "shadow of a point light": lambda: _shadow(_near_light(), _wall()),
    "shadow on a rectangle": lambda: _shadow(_near_light(), _floor()),
    "shadow of a directional light": lambda: _shadow(_sun(), _wall()),
    "shadow of a spot light": lambda: _shadow(_cone(), _wall()),
}
