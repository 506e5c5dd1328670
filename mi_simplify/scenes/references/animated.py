"""
A character as a reference: one Mitsuba scene whose meshes are posed anew for every frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mitsuba as mi
import numpy as np

from ...machine.meshes import mesh_keys
from ...model.asset import Asset, Part, rig_of
from ...model.rig import Rig, Skin, deform, normal_matrices, turn
from ...model.topology import vertex_normals, weld
from ..shapes import rendered_mesh, rendered_part
from ..views import Views
from .mitsuba import MitsubaReference
from .reference import is_aligned


class AnimatedReference:
    """
    A rigged asset, rendered as it stands in the frame of each view.

    Parameters
    ----------
    asset : Asset
        With a rig.
    make : callable
        ``make(shapes)``: the renderer of some Mitsuba shapes, whose :meth:`.mitsuba.MitsubaReference.move` poses them.
    form : {'gltf', 'paper'}
        Mixing of the lobes in ``ggx_gamma``.
    """

    def __init__(self, asset: Asset, make: Callable[[dict], MitsubaReference], form: str = "gltf"):
        bsdfs: dict[tuple, mi.BSDF] = {}
        rig = rig_of(asset)
        self._meshes = [_Posable(f"part_{k}", part, rig) for k, part in enumerate(_skinned(asset))]
        self.reference = make({mesh.name: mesh.shape(bsdfs, form) for mesh in self._meshes})
        self._frame: float | None = None

    @property
    def is_aligned(self) -> bool:
        """See :class:`.reference.AlignedReference`."""
        return is_aligned(self.reference)

    def render(self, views: Views, seed: int = 0, spp: int | None = None) -> np.ndarray:
        """
        See :class:`.reference.AlignedReference`; views of one frame are rendered together.
        """
        out = np.empty((len(views), views.height, views.width, 4), np.float32)
        for k, (index, part) in enumerate(views.by_shape()):
            self._pose(float(part.frame[0]))
            # Aligned samples are the same in all frames, as in the latent renderer; noise is not to be.
            own = seed if self.is_aligned else (seed * len(views) + k) % 2**32
            out[index] = self.reference.render(part, own, spp)
        return out

    def _pose(self, frame: float) -> None:
        if frame == self._frame:
            return
        self._frame = frame
        values: dict[str, np.ndarray] = {}
        for mesh in self._meshes:
            values |= mesh.posed(frame)
        self.reference.move(values)


def _skinned(asset: Asset) -> list[Part]:
    """All instances as parts in the bind pose, a rigid one with the skin of its one joint."""
    out = []
    for instance, part in zip(asset.instances, asset.placed(), strict=True):
        if part.skin is None:
            n = len(part.vertices)
            part = replace(part, skin=Skin(np.full((n, 1), instance.joint), np.ones((n, 1))))
        out.append(part)
    return out


class _Posable:
    """A part as a Mitsuba mesh, and its vertex data in any frame."""

    def __init__(self, name: str, part: Part, rig: Rig):
        self.name, self.rig, self._own_normals = name, rig, part.normals is not None
        self.part, self.normals, self.tangents, _ = rendered_part(part)
        assert self.part.skin is not None
        self.skin = self.part.skin
        self._position_index = weld(self.part.vertices)[1]

    def shape(self, bsdfs: dict[tuple, mi.BSDF], form: str) -> mi.Mesh:
        return rendered_mesh(self.name, self.part, self.normals, self.tangents, bsdfs, form)

    def posed(self, frame: float) -> dict[str, np.ndarray]:
        """New values of the mesh's scene parameters; normals and tangents turn as engines turn them."""
        part, matrices = self.part, self.rig.matrices(frame)
        vertices, tangents = deform(part.vertices, self.skin, matrices), None
        if self._own_normals:
            normals = turn(self.normals, self.skin, normal_matrices(matrices))
        else:
            index = self._position_index
            positions = np.empty((int(index.max()) + 1, 3))
            positions[index] = vertices
            normals = vertex_normals(positions, index[part.faces])[index]
        if self.tangents is not None:
            tangents = turn(self.tangents, self.skin, matrices[:, :3, :3])
        return mesh_keys(self.name, vertices, normals, tangents)
