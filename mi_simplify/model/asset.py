"""
A model as it came from a file, in plain NumPy: parts with materials, placed by instances.

Conventions (docs/conventions.md), translated once by the readers and writers at the file boundary:
right-handed, +Y up, counter-clockwise front faces; UV origin at the *top left* of the image
(v = 0 is row 0, as in glTF and Mitsuba bitmaps; OBJ and USD are flipped when read); textures
linear in memory; normal maps unit vectors in tangent space, +Y up the image (OpenGL).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .rig import Rig, Skin, deform, normal_matrices, turn
from .tree import Tree

#: Bytes that a placement takes.
PER_INSTANCE = 800

#: Bytes that a corner of a face takes as it is read.
PER_CORNER = 100

FEWER_INSTANCES = "place fewer, or simplify the part alone"


@dataclass(frozen=True)
class Lookup:
    """
    Where one texture of a material is looked up.

    Parameters
    ----------
    uvs : int
        Which coordinates of the part: 0 for :attr:`Part.uvs`, k for ``Part.more_uvs[k - 1]``.
    wraps : tuple of {'repeat', 'mirror', 'clamp'}
        What lies beyond the image along u and v.
    """

    uvs: int = 0
    wraps: tuple[str, str] = ("repeat", "repeat")


PLAIN = Lookup()


@dataclass(frozen=True)
class Material:
    """
    A metallic-roughness material; every texture is an image, ``(1, 1, C)`` where constant.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4), float32
        Linear RGB and opacity in [0, 1].
    specular : ndarray, shape (H, W, 3), float32
        (gamma, roughness, metallic) in [0, 1], linear; gamma = 0 leaves the specular lobe as it is.
    normal : ndarray, shape (H, W, 3), float32, or None
        Tangent-space unit vectors in [-1, 1]; None for no map.
    alpha_mode : {'OPAQUE', 'MASK', 'BLEND'}
        As in glTF. OPAQUE ignores the opacity channel.
    alpha_cutoff : float
        Opacity threshold of MASK.
    emission : ndarray, shape (H, W, 3), float32, or None
        Linear radiance of its own light, not below 0; None for none. It is seen, but lights nothing else.
    occlusion : ndarray, shape (H, W, 1), float32, or None
        Share of light from everywhere that arrives, in [0, 1]; carried along, no renderer here uses it.
    double_sided : bool
        Whether its back is seen, as the file has it; renderers here show it always.
    lobes : mapping of str to mapping
        What else reflects or transmits, by the names and with the factors of glTF's extensions; carried along, no
        renderer here shows it.
    lookups : mapping of str to Lookup
        Of the textures that are not looked up plainly, by the name of the field above. The normal map always is at
        :attr:`Part.uvs`, whose tangents it needs.
    """

    name: str = "default"
    base_color: np.ndarray = field(default_factory=lambda: np.array([[[0.5, 0.5, 0.5, 1.0]]], np.float32))
    specular: np.ndarray = field(default_factory=lambda: np.array([[[0.0, 0.5, 0.0]]], np.float32))
    normal: np.ndarray | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    emission: np.ndarray | None = None
    occlusion: np.ndarray | None = None
    double_sided: bool = True
    lobes: Mapping[str, Any] = field(default_factory=dict)
    lookups: Mapping[str, Lookup] = field(default_factory=dict)

    def lookup(self, texture: str) -> Lookup:
        """Where a texture is looked up, by the name of its field."""
        return self.lookups.get(texture, PLAIN)


@dataclass(frozen=True)
class Morph:
    """
    A morph target.

    Parameters
    ----------
    name : str
    offsets : ndarray, shape (V, 3), float64
        What is added to the positions of a part at weight 1 [units of the file].
    weight : float
        Its default, with which the part's positions are as they are.
    """

    name: str
    offsets: np.ndarray
    weight: float = 0.0


@dataclass(frozen=True)
class Part:
    """
    An indexed triangle mesh with one material, in its own frame.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3), float64
        Positions [units of the file].
    faces : ndarray, shape (F, 3), int64
        Counter-clockwise vertex indices.
    normals : ndarray, shape (V, 3), float32, or None
        Unit shading normals of the file; None means angle-weighted normals over welded positions.
    uvs : ndarray, shape (V, 2), float32, or None
        Texture coordinates, origin top left, any range (textures repeat).
    colors : ndarray, shape (V, 4), float32, or None
        Linear vertex colours and opacity, multiplied onto the base colour.
    skin : Skin, optional
        Which joints of the asset's rig pull at the vertices, where it has one.
    more_uvs : tuple of ndarray, shape (V, 2), float32
        Further texture coordinates, which the material's :class:`Lookup` names.
    morphs : tuple of Morph
    place : tuple of int
        Of a glTF file: its mesh, the primitive in it, and the material, -1 for none; else empty.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    colors: np.ndarray | None = None
    material: Material = field(default_factory=Material)
    name: str = "part"
    skin: Skin | None = None
    more_uvs: tuple[np.ndarray, ...] = ()
    morphs: tuple[Morph, ...] = ()
    place: tuple[int, ...] = ()


@dataclass(frozen=True)
class Instance:
    """
    One placement of a part.

    Parameters
    ----------
    part : int
        Index into ``Asset.parts``.
    to_world : ndarray, shape (4, 4), float64
        Affine transform, column vectors; may mirror. In an asset with a rig: in the bind pose.
    joint : int, optional
        Joint of the asset's rig that carries the whole part, where that has no skin; every instance of an asset with a
        rig has the one or the other.
    node : str
        The nodes above it in the file's tree, from the root on, with slashes between; empty where there are none.
    at : int
        Its node in the asset's tree; -1 where it follows none.
    """

    part: int
    to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    name: str = "instance"
    node: str = ""
    joint: int | None = None
    at: int = -1


@dataclass(frozen=True)
class Asset:
    """
    Everything that was read from one file: parts, and where each of them stands.
    """

    parts: tuple[Part, ...]
    instances: tuple[Instance, ...]
    name: str = "asset"
    source: str = ""
    notes: tuple[str, ...] = ()
    """What the reader left out or repaired, one line each, for the log and the report."""
    ambient: np.ndarray | None = None
    """Of a fitted model: the light besides point lights that belongs to it, (K, 3), see :mod:`..latent.ambient`."""
    rig: Rig | None = None
    """Skeleton and animation of a character; the asset itself then stands in its bind pose, see :meth:`posed`."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Of the file as a whole, carried over as it is: 'copyright', and 'extras', JSON values of glTF's ``asset``."""
    tree: Tree | None = None
    """The nodes of a file that has some which can be kept, by name and transform."""

    @property
    def n_triangles(self) -> int:
        """Triangles of the scene, instances counted each."""
        return sum(len(self.parts[i.part].faces) for i in self.instances)

    @property
    def bounds(self) -> np.ndarray:
        """Axis-aligned box over referenced vertices, shape (2, 3), world units."""
        points = [
            self.parts[i.part].vertices[np.unique(self.parts[i.part].faces)] @ i.to_world[:3, :3].T + i.to_world[:3, 3]
            for i in self.instances
        ]
        return np.stack([np.min([p.min(0) for p in points], 0), np.max([p.max(0) for p in points], 0)])

    def placed(self) -> list[Part]:
        """
        One part per instance with positions and normals in world space; mirrored ones are rewound.
        """
        out = []
        for inst in self.instances:
            part = self.parts[inst.part]
            linear = inst.to_world[:3, :3]
            normals = part.normals
            if normals is not None:
                # Cofactors, the inverse but for a factor, are there for what is flattened to a plane as well.
                cofactors = np.cross(np.roll(linear, -1, axis=0), np.roll(linear, -2, axis=0))
                normals = normals @ cofactors.T * (-1 if np.linalg.det(linear) < 0 else 1)
                normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
                normals = normals.astype(np.float32)
            faces = part.faces[:, ::-1] if np.linalg.det(linear) < 0 else part.faces
            vertices = part.vertices @ linear.T + inst.to_world[:3, 3]
            morphs = tuple(replace(morph, offsets=morph.offsets @ linear.T) for morph in part.morphs)
            out.append(replace(part, vertices=vertices, faces=faces, normals=normals, name=inst.name, morphs=morphs))
        return out

    def transformed(self, to_world: np.ndarray) -> Asset:
        """
        The asset with an affine transform, shape (4, 4), put in front of every instance.
        """
        moved = tuple(replace(i, to_world=to_world @ i.to_world) for i in self.instances)
        rig = None if self.rig is None else self.rig.transformed(to_world)
        tree = None if self.tree is None else self.tree.transformed(to_world)
        return replace(self, instances=moved, rig=rig, tree=tree)

    def posed(self, frame: float = 0) -> Asset:
        """
        The asset as it stands in a frame, without a rig.

        Parameters
        ----------
        frame : float
            Index into the clip of the rig, see :meth:`.rig.Rig.matrices`; an asset without one stays as it is.
        """
        if self.rig is None:
            return self
        if frame < 0:
            return replace(self, rig=None)
        matrices = self.rig.matrices(frame)
        parts, instances = list(self.parts), []
        placed = self.placed()
        for instance, part in zip(self.instances, placed, strict=True):
            if part.skin is None:
                moved = instance.to_world if instance.joint is None else matrices[instance.joint] @ instance.to_world
                instances.append(replace(instance, to_world=moved, joint=None))
            else:
                vertices, normals = deform(part.vertices, part.skin, matrices), part.normals
                if normals is not None:
                    normals = turn(normals, part.skin, normal_matrices(matrices))
                instances.append(Instance(len(parts), name=instance.name))
                parts.append(replace(part, vertices=vertices, normals=normals, skin=None))
        return replace(self, parts=tuple(parts), instances=tuple(instances), rig=None)

    def influences(self) -> np.ndarray:
        """
        Weights of all placed vertices over all joints, one part after the other as :meth:`placed` has them.

        Returns
        -------
        ndarray, shape (V, J), float32
        """
        n = len(rig_of(self).names)
        out = []
        for instance in self.instances:
            part = self.parts[instance.part]
            if part.skin is not None:
                out.append(part.skin.matrix(n).toarray().astype(np.float32))
            else:
                out.append(np.tile(np.eye(n, dtype=np.float32)[instance.joint], (len(part.vertices), 1)))
        return np.concatenate(out)


def rig_of(asset: Asset) -> Rig:
    """
    The rig of an asset that is known to have one.
    """
    assert asset.rig is not None, f"{asset.name} has no rig"
    return asset.rig
