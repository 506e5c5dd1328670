"""
Cameras and punctual lights of a glTF file, which no asset carries.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....errors import AssetError
from ..file import GltfFile
from ..motion import scene_nodes


@dataclass(frozen=True)
class Camera:
    """
    A perspective camera, which looks along -Z with +Y up.

    Parameters
    ----------
    name : str
    to_world : ndarray, shape (4, 4)
        Rigid.
    yfov : float
        Vertical field of view [radians].
    aspect : float or None
        Width over height where the file says so.
    """

    name: str
    to_world: np.ndarray
    yfov: float
    aspect: float | None


@dataclass(frozen=True)
class PointLight:
    """
    A point light that stands for one of the file.

    Parameters
    ----------
    name : str
    position : ndarray, shape (3,)
    intensity : ndarray, shape (3,)
        Radiance times squared unit of length, as of :class:`....scenes.views.Views`.
    """

    name: str
    position: np.ndarray
    intensity: np.ndarray


def read_stage(path: str | Path, bounds: np.ndarray) -> tuple[list[Camera], list[PointLight], list[str]]:
    """
    The perspective cameras and the lights of the default scene of a file, brightest at the scene's centre first.

    Parameters
    ----------
    bounds : ndarray, shape (2, 3)
        Box of the scene. A directional light is a point light so far outside of it that its rays are parallel to a
        thousandth.

    Returns
    -------
    cameras, lights : list
    notes : list of str
        What could not be taken as it is.

    Raises
    ------
    AssetError
        A camera or a light is malformed.
    """
    file, notes = GltfFile(Path(path), []), []
    lights_json = ((file.json.get("extensions") or {}).get("KHR_lights_punctual") or {}).get("lights") or []
    center, radius = bounds.mean(0), float(np.linalg.norm(bounds[1] - bounds[0])) / 2
    cameras: list[Camera] = []
    lights: list[PointLight] = []
    for index, to_world in scene_nodes(file)[0].items():
        node = file.item("nodes", index)
        if node.get("camera") is not None:
            source = file.item("cameras", node["camera"])
            name = str(node.get("name") or source.get("name") or f"camera_{node['camera']}")
            if source.get("type") != "perspective":
                notes.append(f"camera '{name}' is not perspective and was left out")
            else:
                cameras.append(_camera(file, source.get("perspective") or {}, name, to_world))
        number = ((node.get("extensions") or {}).get("KHR_lights_punctual") or {}).get("light")
        if number is not None:
            if not isinstance(number, int) or not 0 <= number < len(lights_json):
                raise AssetError(f"{file.name}: it refers to light {number!r:.20}, which does not exist")
            lights.append(_light(file, lights_json[number], str(node.get("name") or number), to_world, center, radius))
            if lights_json[number].get("type") == "spot":
                notes.append(f"spot light '{lights[-1].name}' shines in all directions here")
    lights.sort(key=lambda light: -float(light.intensity.sum() / max(np.sum((light.position - center) ** 2), 1e-12)))
    return cameras, lights, notes


def _camera(file: GltfFile, perspective: dict[str, Any], name: str, to_world: np.ndarray) -> Camera:
    yfov, aspect = perspective.get("yfov"), perspective.get("aspectRatio")
    if not isinstance(yfov, int | float) or not 0 < yfov < np.pi:
        raise AssetError(f"{file.name}: camera '{name}' needs a yfov between 0 and π, got {yfov!r:.20}")
    out = np.eye(4)
    out[:3, :3] = to_world[:3, :3] / np.maximum(np.linalg.norm(to_world[:3, :3], axis=0), 1e-20)  # scale does not count
    out[:3, 3] = to_world[:3, 3]
    if not np.allclose(out[:3, :3].T @ out[:3, :3], np.eye(3), atol=1e-3) or np.linalg.det(out[:3, :3]) < 0:
        raise AssetError(f"{file.name}: camera '{name}' is mirrored or skewed by its nodes; export it again")
    return Camera(name, out, float(yfov), float(aspect) if isinstance(aspect, int | float) and aspect > 0 else None)


def _light(
    file: GltfFile, source: dict[str, Any], name: str, to_world: np.ndarray, center: np.ndarray, radius: float
) -> PointLight:
    try:
        color = np.broadcast_to(np.array(source.get("color", (1, 1, 1)), np.float64), 3)
        strength = color * float(source.get("intensity", 1))
        kind = source["type"]
        if not np.isfinite(strength).all() or (strength < 0).any() or kind not in ("point", "spot", "directional"):
            raise ValueError
    except (LookupError, TypeError, ValueError):
        raise AssetError(f"{file.name}: light '{name}' is malformed; export it again") from None
    if kind != "directional":
        return PointLight(name, to_world[:3, 3], strength)
    towards = to_world[:3, 2] / max(float(np.linalg.norm(to_world[:3, 2])), 1e-20)  # it shines along -Z
    distance = _FAR * max(radius, 1e-12)
    return PointLight(name, center + distance * towards, strength * distance**2)


#: How many radii of the scene a directional light stands away.
_FAR = 1000.0
