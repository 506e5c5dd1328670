"""
How the prims and skeletons of a USD stage move, by time code.
"""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from ...errors import AssetError
from ..influences import MAX_FRAMES
from ..resources import Resources
from .values import matrix


class Motion:
    """
    The clip of a stage.

    Parameters
    ----------
    stage : Usd.Stage
    resources : Resources
        Takes the notes.
    queries : list of UsdSkel.SkeletonQuery
    rigid : list of Usd.Prim
        What moves besides the skeletons.

    Attributes
    ----------
    codes : ndarray, shape (T,)
        Time codes of its frames.
    """

    def __init__(
        self, stage: Usd.Stage, resources: Resources, queries: list[UsdSkel.SkeletonQuery], rigid: list[Usd.Prim]
    ):
        self.stage, self.resources = stage, resources
        self.codes = self._codes(queries, rigid)
        self._caches = [UsdGeom.XformCache(Usd.TimeCode(code)) for code in self.codes]

    def world(self, prim: Usd.Prim) -> np.ndarray:
        """
        World transforms of a prim in every frame, shape (T, 4, 4).
        """
        return np.stack([matrix(cache.GetLocalToWorldTransform(prim)) for cache in self._caches])

    def joints(self, query: UsdSkel.SkeletonQuery) -> np.ndarray:
        """
        Joints in their skeleton's space in every frame, shape (T, J, 4, 4).

        Raises
        ------
        AssetError
            The skeleton has no pose in one of them.
        """
        poses = []
        for code in self.codes:
            found = query.ComputeJointSkelTransforms(Usd.TimeCode(code))
            if found is None or len(found) != len(query.GetJointOrder()):
                name = query.GetPrim().GetName()
                raise AssetError(
                    f"{self.resources.model.name}: skeleton '{name}' has no pose at {code:g}; export it again"
                )
            poses.append(np.stack([matrix(m) for m in found]))
        return np.stack(poses)

    def _codes(self, queries: list[UsdSkel.SkeletonQuery], rigid: list[Usd.Prim]) -> np.ndarray:
        """Time codes of the clip: those of the samples, and whole ones between samples that lie far apart."""
        samples: set[float] = set()
        for query in queries:
            anim = query.GetAnimQuery()
            samples.update(anim.GetJointTransformTimeSamples() if anim else ())
        for p in {
            p.GetPath(): p for prim in [*(q.GetPrim() for q in queries), *rigid] for p in with_parents(prim)
        }.values():
            xformable = UsdGeom.Xformable(p)
            samples.update(xformable.GetTimeSamples() if xformable else ())
        codes = np.array(sorted(samples))
        codes = codes[np.isfinite(codes)]
        if self.stage.HasAuthoredTimeCodeRange():
            within = codes[(codes >= self.stage.GetStartTimeCode()) & (codes <= self.stage.GetEndTimeCode())]
            codes = within if len(within) > 1 else codes
        if len(codes) < 2:
            return np.zeros(1) if not len(codes) else codes
        if np.diff(codes).max() > 1.5 and np.ptp(codes) <= MAX_FRAMES:
            codes = np.unique(np.concatenate([codes, np.arange(np.ceil(codes[0]), codes[-1])]))
        if len(codes) > MAX_FRAMES:
            self.resources.note(f"of {len(codes)} frames one in {-(-len(codes) // MAX_FRAMES)} was taken")
            codes = codes[:: -(-len(codes) // MAX_FRAMES)]
        return codes


def moves(prim: Usd.Prim) -> bool:
    """
    Whether a transform of a prim or above it has more than one time sample.
    """
    xforms = (UsdGeom.Xformable(p) for p in with_parents(prim))
    return any(x and len(x.GetTimeSamples()) > 1 for x in xforms)


def with_parents(prim: Usd.Prim) -> list[Usd.Prim]:
    """
    A prim and those above it, upwards.
    """
    out = []
    while prim and not prim.IsPseudoRoot():
        out.append(prim)
        prim = prim.GetParent()
    return out
