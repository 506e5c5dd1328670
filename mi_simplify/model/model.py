"""
The small textured mesh in plain NumPy: what the first guess makes, the fit improves, the export writes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .asset import Asset, Instance, Material, Part
from .groups import Group, Groups
from .mesh import Mesh
from .rigging import Rigging
from .tessellation import Tessellation
from .tree import Nodes


@dataclass(frozen=True)
class Displacement:
    """
    How a base mesh is split and moved along its normals, see :mod:`.tessellation`.

    Parameters
    ----------
    height : ndarray, shape (H, W), float32
        Displacement along the interpolated unit normal [units of the mesh].
    subdivisions : int
        How often every face is split in four.
    fitted : tuple of int
        Subdivisions that it is fitted for at once; empty: ``subdivisions`` alone.
    """

    height: np.ndarray
    subdivisions: int
    fitted: tuple[int, ...] = ()

    @property
    def framed(self) -> int:
        """
        Subdivisions of the displaced mesh whose normals, interpolated, shade all finer ones: the coarsest one fitted.

        So one normal map serves them all. Normals of the base mesh would do so as well, and for a mesh that its user
        subdivides further, but lie so far from those of the relief that path tracers show it too dark.
        """
        return min((self.subdivisions, *self.fitted))


@dataclass(frozen=True)
class VertexSets:
    """
    Positions for smaller sizes on the screen, see :mod:`..latent.vertex_sets`.

    Parameters
    ----------
    sizes : tuple of float
        Sides of the images that each set is for [pixels], falling; the first is that of the mesh's own positions.
    offsets : ndarray, shape (K - 1, P, 3)
        What is added to the mesh's positions for each of the other sizes.
    """

    sizes: tuple[float, ...]
    offsets: np.ndarray


@dataclass(frozen=True)
class Morphs:
    """
    Morph targets of the asset on the small mesh.

    Parameters
    ----------
    names : tuple of str
    weights : tuple of float
        Defaults, with which the mesh's positions are as they are.
    offsets : ndarray, shape (K, P, 3)
        What each adds to the positions at weight 1.
    """

    names: tuple[str, ...]
    weights: tuple[float, ...]
    offsets: np.ndarray


@dataclass(frozen=True)
class Model:
    """
    Mesh and PBR textures of one material.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4), float32
        Linear RGB and opacity.
    specular : ndarray, shape (H, W, 3), float32
        (gamma, roughness, metallic), linear.
    normal : ndarray, shape (H, W, 3), float32
        Unit vectors in MikkTSpace tangent space, +Y up the image.
    alpha_mode : {'OPAQUE', 'MASK', 'BLEND'}
        As in glTF.
    mips : tuple of dict
        Coarser levels of the textures where they are the model's own and not means of the finest: ``base_color``,
        ``specular`` and ``normal``, each half as large as the one before.
    displacement : Displacement, optional
        With it ``mesh`` is a base mesh, and the textures belong to what it is displaced into.
    vertex_sets : VertexSets, optional
        Other positions for smaller sizes on the screen.
    ambient : ndarray, shape (K, 3), float32, optional
        The light besides point lights that it was fitted under, see :mod:`..latent.ambient`.
    skin : Rigging, optional
        Skeleton, clip and weights of a character, whose mesh stands in its bind pose.
    emission : ndarray, shape (H, W, 3), float32, or None
    occlusion : ndarray, shape (H, W, 1), float32, or None
        As in :class:`.asset.Material`; baked from the asset, and left alone by the fit.
    groups : Groups, optional
        What the faces differ in besides textures; without them all are of ``alpha_mode`` and shown from both sides.
    morphs : Morphs, optional
        Not together with ``displacement`` or ``vertex_sets``.
    cells : ndarray, shape (M, 4), int64, optional
        Of a model of several materials: the rectangle (left, top, width, height) of each in the images [texels], of
        which the mesh's texture coordinates are those; without them the images are one texture.
    nodes : Nodes, optional
        Nodes of the asset that are kept; not together with ``displacement`` or ``vertex_sets``. Instances are in the
        mesh once: :func:`.nodes.placing.expanded` has them all.
    metadata : mapping
        Of the asset, see :attr:`.asset.Asset.metadata`.
    """

    mesh: Mesh
    base_color: np.ndarray
    specular: np.ndarray
    normal: np.ndarray
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    name: str = "model"
    mips: tuple[dict[str, np.ndarray], ...] = ()
    ambient: np.ndarray | None = None
    displacement: Displacement | None = None
    skin: Rigging | None = None
    vertex_sets: VertexSets | None = None
    emission: np.ndarray | None = None
    occlusion: np.ndarray | None = None
    groups: Groups | None = None
    morphs: Morphs | None = None
    cells: np.ndarray | None = None
    nodes: Nodes | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def face_groups(self) -> Groups:
        """The groups, one where there are none."""
        if self.groups is not None:
            return self.groups
        whole = Group(self.name, self.alpha_mode, self.alpha_cutoff)
        return Groups((whole,), np.zeros(len(self.mesh.faces), np.int64))

    @property
    def n_triangles(self) -> int:
        """Number of triangles that are shown, those of instances counted each."""
        return len(self.mesh.faces) if self.nodes is None else self.nodes.n_shown(self.mesh.position_faces)

    @property
    def material(self) -> Material:
        """The textures as a material of the scenes stage."""
        return Material(
            self.name, self.base_color, self.specular, self.normal, self.alpha_mode, self.alpha_cutoff,
            self.emission, self.occlusion,
        )  # fmt: skip

    def transformed(self, scale: float, offset: np.ndarray) -> Model:
        """
        The model with positions ``p * scale + offset`` (uniform scale, so textures stay valid).
        """
        mesh = replace(self.mesh, positions=self.mesh.positions * scale + np.asarray(offset))
        displacement = self.displacement
        if displacement is not None:
            displacement = replace(displacement, height=(displacement.height * scale).astype(np.float32))
        sets = self.vertex_sets
        if sets is not None:
            sets = replace(sets, offsets=sets.offsets * scale)
        skin = None if self.skin is None else self.skin.transformed(scale, offset)
        morphs = None if self.morphs is None else replace(self.morphs, offsets=self.morphs.offsets * scale)
        nodes = self.nodes
        if nodes is not None:
            matrix = np.diag([scale, scale, scale, 1.0])
            matrix[:3, 3] = offset
            nodes = nodes.transformed(matrix)
        return replace(
            self, mesh=mesh, displacement=displacement, vertex_sets=sets, skin=skin, morphs=morphs, nodes=nodes
        )

    def taking(self, fitted: Model, quantities: Collection[str]) -> Model:
        """
        Some quantities of a model fitted from this one, everything else as it is here, to the bit.

        Parameters
        ----------
        quantities : collection of str
            Of vertices, base_color, opacity, gamma, roughness, metallic, normal; what a mesh operation has besides is
            the fitted model's, which left it alone where it was not to be fitted.
        """
        mesh = fitted.mesh
        if not {"vertices", "weights"} & set(quantities):
            mesh = replace(mesh, positions=self.mesh.positions)

        taken = {name: np.array([owner in quantities for owner in owners]) for name, owners in _OWNERS.items()}
        images = {name: np.where(taken[name], getattr(fitted, name), getattr(self, name)) for name in taken}
        mips = fitted.mips
        if self.mips:
            mips = tuple(
                {name: np.where(taken[name], new[name], old[name]) for name in taken}
                for new, old in zip(mips, self.mips, strict=True)
            )
        return replace(fitted, mesh=mesh, mips=mips, **images)

    def as_asset(self) -> Asset:
        """
        The model as an asset of one part, displaced, with the normals that it is fitted with, and its rig; without
        instances.
        """
        if self.displacement is not None:
            return tessellated(self).as_asset()
        skin = None if self.skin is None else self.skin.skin().taken(self.mesh.position_index)
        part = Part(
            vertices=self.mesh.vertices,
            faces=self.mesh.faces,
            normals=self.mesh.normals()[self.mesh.normal_groups].astype(np.float32),
            uvs=self.mesh.uvs,
            material=self.material,
            name=self.name,
            skin=skin,
        )
        rig = None if self.skin is None else self.skin.rig
        return Asset(
            (part,), (Instance(0, name=self.name),), name=self.name, ambient=self.ambient, rig=rig,
            metadata=self.metadata,
        )  # fmt: skip


def tessellated(model: Model, subdivisions: int | None = None) -> Model:
    """
    A displaced model as the mesh that it stands for.

    Parameters
    ----------
    subdivisions : int, optional
        Those of the model's displacement if not given.
    """
    displacement = model.displacement
    if displacement is None:
        return model
    level = displacement.subdivisions if subdivisions is None else subdivisions
    tessellation = Tessellation.of(model.mesh, level)
    mesh = replace(tessellation.mesh, positions=tessellation.positions(model.mesh.positions, displacement.height))
    if level > displacement.framed:
        coarse = tessellated(model, displacement.framed).mesh
        mesh = replace(mesh, own_normals=tessellation.interpolated(coarse.normals(), displacement.framed))
    groups = None if model.groups is None else model.groups.split(level)
    return replace(model, mesh=mesh, displacement=None, groups=groups)


#: Which quantities the channels of the textures are.
_OWNERS = {
    "base_color": ("base_color",) * 3 + ("opacity",),
    "specular": ("gamma", "roughness", "metallic"),
    "normal": ("normal",) * 3,
}
