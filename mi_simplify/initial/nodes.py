"""
Which nodes of an asset stay nodes, and the asset with each of their meshes once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..config import InitialSettings
from ..config.problems import nearest
from ..errors import ConfigError
from ..model.asset import Asset
from ..model.tree import Nodes, Tree

#: Nodes whose transform has a smaller determinant have no inverse to speak of.
_FLAT = 1e-30


@dataclass(frozen=True)
class Kept:
    """
    Parameters
    ----------
    single : Asset
        The asset without those instances whose mesh an earlier node shows.
    tree : Tree
        The nodes that are kept.
    mesh : ndarray, shape (I,), int64
        Of each instance of ``single``, the mesh that it is a piece of: everything at or below a kept node that no other
        kept node is closer to.
    placed, joints : tuple of tuple of int
        As of :class:`.tree.Nodes`.
    """

    single: Asset
    tree: Tree
    mesh: np.ndarray
    placed: tuple[tuple[int, ...], ...]
    joints: tuple[tuple[int, ...], ...]

    def times(self) -> np.ndarray:
        """How often each mesh is shown, shape (number of meshes,)."""
        return np.array([len(nodes) for nodes in self.placed])

    def nodes(self, of_position: np.ndarray) -> Nodes:
        """Those of a model, by the mesh of each of its positions."""
        return Nodes(self.tree, of_position, self.placed, self.joints)


def kept_nodes(asset: Asset, settings: InitialSettings) -> Kept | None:
    """
    The nodes that the settings keep, and animated ones with something below them; None where these are none.

    A node whose transform has no inverse is not kept.

    Raises
    ------
    ConfigError
        Nodes are to be kept of an asset that has none, or one that it has not.
    """
    asked = settings.keep_nodes == "all" or bool(settings.keep)
    other = settings.source is not None or settings.subdivisions > 0 or settings.vertex_sets > 1
    if settings.keep_nodes == "none" or settings.kind != "decimate" or other:
        return None
    tree = asset.tree
    if tree is None:
        if asked:
            raise ConfigError(
                f"initial.keep_nodes: {asset.name} has no nodes to keep: only glTF files without a skin have; leave "
                "--keep-nodes and --keep out"
            )
        return None
    if asset.rig is None:  # what moves shows nothing
        tree = replace(tree, moving=tree.moving[:0], motion=tree.motion[:, :0])
    at = np.array([instance.at for instance in asset.instances])
    which = _which(asset, tree, tree.carrying(at[at >= 0]), settings)
    if not which.any():
        return None
    kept, above = tree.kept(which)
    owner = np.where(at >= 0, above[at], -1)
    return _sorted(asset, kept, owner)


def require_no_nodes(settings: InitialSettings) -> None:
    """
    Raise :class:`ConfigError` where nodes are to be kept of what cannot have any.
    """
    if settings.keep_nodes == "all" or settings.keep:
        raise ConfigError(
            "initial.keep_nodes: nodes are kept of glTF files that Mitsuba renders; leave --keep-nodes and --keep out"
        )


def _which(asset: Asset, tree: Tree, carrying: np.ndarray, settings: InitialSettings) -> np.ndarray:
    """Nodes that are kept, shape (N,), bool."""
    names = np.array(tree.names)
    which = np.isin(names, settings.keep) | (settings.keep_nodes == "all")
    for name in settings.keep:
        if name not in tree.names:
            raise ConfigError(
                f"initial.keep: {asset.name} has no node '{name}'{nearest(name, tree.names)}; `mi-simplify inspect` "
                "lists them"
            )
    which[tree.moving] |= carrying[tree.moving]
    return which & (np.abs(np.linalg.det(tree.world()[:, :3, :3])) > _FLAT)


def _sorted(asset: Asset, tree: Tree, owner: np.ndarray) -> Kept:
    """Instances by the node that owns them; nodes that show the same share a mesh."""
    world = np.concatenate([tree.world(), tree.frame[None]])  # the last is that of the root, -1
    inverse = np.linalg.inv(world)
    meshes: dict[tuple, int] = {}
    placed: list[list[int]] = []
    joints: list[list[int]] = []
    mesh = np.full(len(owner), -1)
    for node in np.unique(owner).tolist():
        members = np.flatnonzero(owner == node)
        shown = tuple((asset.instances[i].part, _place(inverse[node] @ asset.instances[i].to_world)) for i in members)
        key = shown if node >= 0 else (node,)
        if key not in meshes:
            meshes[key] = len(placed)
            placed.append([])
            joints.append([])
            mesh[members] = meshes[key]
        placed[meshes[key]].append(node)
        joint = asset.instances[int(members[0])].joint
        joints[meshes[key]] += [] if joint is None else [joint]
    single = replace(asset, instances=tuple(i for i, m in zip(asset.instances, mesh, strict=True) if m >= 0))
    carried = tuple(map(tuple, joints)) if asset.rig is not None else ()
    return Kept(single, tree, mesh[mesh >= 0], tuple(map(tuple, placed)), carried)


def _place(matrix: np.ndarray) -> bytes:
    """A transform as a key, without what rounding does to it."""
    return (np.round(matrix / max(1.0, np.abs(matrix).max()), 7) + 0.0).tobytes()
