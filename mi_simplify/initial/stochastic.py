"""
Stochastic simplification of aggregate detail, the baseline that cards are compared with.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import MeshError
from ..model.asset import Asset, Instance, Material, Part
from ..model.topology import area_vectors
from .guess import mean_material


def stochastic(asset: Asset, triangles: int, *, seed: int = 0, per_pixel: float = 4.0) -> Asset:
    """
    Some of an asset's placements, larger and less different from each other (Cook et al. 2007).

    Elements are dropped in an order drawn once, until the budget is met. A share λ of the area being left, the others
    grow by 1/λ in area about their own middles, so that as much is covered. A pixel now averages fewer elements of the
    same variance; so their colours move towards the mean: with k elements in a pixel before, and at least one after,
    deviations shrink by ``sqrt(max(λ k, 1) / k)``, which keeps the variance of pixels (Sect. 3.3).

    Parameters
    ----------
    asset : Asset
        Its elements are its placements; those of a single mesh cannot be told apart.
    triangles : int
        Budget.
    seed : int
        Of the order.
    per_pixel : float
        Elements that a pixel shows of the asset, k: the larger, the smaller the images that the result is made for.

    Returns
    -------
    Asset

    Raises
    ------
    MeshError
        Not even one placement is within the budget.
    """
    placed = [i for i in asset.instances if len(asset.parts[i.part].faces)]
    counts = np.array([len(asset.parts[i.part].faces) for i in placed])
    order = np.random.default_rng(seed).permutation(len(placed))
    kept = order[_within(counts[order], triangles)]
    if not len(kept):
        raise MeshError(f"{asset.name}: no placement has at most {triangles} triangles, so all would be dropped")
    area = np.array([_area(asset.parts[i.part], i.to_world) for i in placed])
    left = area[kept].sum() / area.sum()
    grown = tuple(_grown(placed[k], asset.parts[placed[k].part], left**-0.5) for k in sorted(kept))
    contrast = np.sqrt(max(left * per_pixel, 1.0) / per_pixel)
    mean, _ = mean_material(asset)
    materials = {id(p.material): p.material for p in asset.parts}
    flatter = {key: _flatter(m, mean[:3], contrast) for key, m in materials.items()}
    parts = tuple(replace(p, material=flatter[id(p.material)]) for p in asset.parts)
    return replace(asset, parts=parts, instances=grown)


def _within(counts: np.ndarray, budget: int) -> np.ndarray:
    """Positions that are taken one after the other where the budget still allows for them."""
    left, out = budget, []
    for k, n in enumerate(counts.tolist()):
        if n <= left:
            left -= n
            out.append(k)
    return np.array(out, np.int64)


def _area(part: Part, to_world: np.ndarray) -> float:
    c = (part.vertices @ to_world[:3, :3].T)[part.faces]
    return float(np.linalg.norm(area_vectors(c), axis=1).sum() / 2)


def _grown(instance: Instance, part: Part, factor: float) -> Instance:
    """Larger by a factor of its lengths about the middle of its box."""
    points = part.vertices[np.unique(part.faces)]
    middle = (points.min(0) + points.max(0)) / 2
    about = np.eye(4)
    about[:3, :3] *= factor
    about[:3, 3] = (1 - factor) * middle
    return replace(instance, to_world=instance.to_world @ about)


def _flatter(material: Material, mean: np.ndarray, contrast: float) -> Material:
    base = material.base_color.copy()
    base[..., :3] = np.clip(mean + (base[..., :3] - mean) * contrast, 0, 1)
    return replace(material, base_color=base.astype(np.float32))
