"""
The nodes of a file: a tree of names and transforms, some of which are animated, and which part of a model they show.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True)
class Tree:
    """
    Nodes as a file has them, parents before their children.

    Parameters
    ----------
    names : tuple of str
        Empty where a node has none; several may be alike.
    parents : ndarray, shape (N,), int64
        Node above each; -1 for none.
    local : ndarray, shape (N, 4, 4), float64
        Transform of each at rest, to the node above it; column vectors.
    moving : ndarray, shape (M,), int64
        Nodes that are animated.
    motion : ndarray, shape (T, M, 4, 4), float64
        Their own transforms in every frame of the clip.
    frame : ndarray, shape (4, 4), float64
        From the space of the file to that of the asset or the model that has the tree.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    local: np.ndarray
    moving: np.ndarray
    motion: np.ndarray
    frame: np.ndarray = field(default_factory=lambda: np.eye(4))

    def world(self) -> np.ndarray:
        """
        From each node at rest to the space of the asset, shape (N, 4, 4).
        """
        out = np.empty_like(self.local)
        for k, parent in enumerate(self.parents.tolist()):
            out[k] = (self.frame if parent < 0 else out[parent]) @ self.local[k]
        return out

    def paths(self) -> list[str]:
        """
        Names of the nodes, after those of the nodes above them with slashes between; numbers where one has none.
        """
        out: list[str] = []
        for k, (name, parent) in enumerate(zip(self.names, self.parents.tolist(), strict=True)):
            out.append((f"{out[parent]}/" if parent >= 0 else "") + (name or f"{k}"))
        return out

    def transformed(self, to_world: np.ndarray) -> Tree:
        """
        That of an asset with an affine transform, shape (4, 4), put in front of everything.
        """
        return replace(self, frame=to_world @ self.frame)

    def carrying(self, nodes: np.ndarray) -> np.ndarray:
        """
        Which nodes have one of some others at or below them, shape (N,), bool.
        """
        out = np.zeros(len(self.names), bool)
        out[nodes] = True
        for k in range(len(out) - 1, -1, -1):
            if out[k] and self.parents[k] >= 0:
                out[self.parents[k]] = True
        return out

    def kept(self, which: np.ndarray) -> tuple[Tree, np.ndarray]:
        """
        The tree of some of its nodes alone, each with the transforms of those left out above it.

        Parameters
        ----------
        which : ndarray, shape (N,), bool
            Of a node that is left out the motion is lost.

        Returns
        -------
        tree : Tree
        above : ndarray, shape (N,), int64
            Number in the new tree of the kept node at or above each node; -1 for none.
        """
        n = len(self.names)
        number = np.cumsum(which) - 1
        above, rest = np.full(n + 1, -1), np.tile(np.eye(4), (n + 1, 1, 1))  # the last stands for the root
        parents, before = [], []
        for k, parent in enumerate(self.parents.tolist()):
            if which[k]:
                parents.append(above[parent])
                before.append(rest[parent])
                above[k] = number[k]
            else:
                above[k], rest[k] = above[parent], rest[parent] @ self.local[k]
        lead = np.array(before).reshape(-1, 4, 4)
        still = which[self.moving]
        moving = number[self.moving[still]]
        names = tuple(name for name, kept in zip(self.names, which, strict=True) if kept)
        tree = Tree(
            names, np.array(parents, np.int64), lead @ self.local[which], moving,
            lead[moving] @ self.motion[:, still], self.frame,
        )  # fmt: skip
        return tree, above[:n]


@dataclass(frozen=True)
class Nodes:
    """
    The nodes of an asset that a model keeps, each with a mesh of its own.

    The model holds each mesh once, where the first node that shows it stands; no position belongs to two of them.

    Parameters
    ----------
    tree : Tree
        The nodes that are kept, those without a mesh among them.
    of_position : ndarray, shape (P,), int64
        The mesh that each of the model's welded positions belongs to.
    placed : tuple of tuple of int
        For each mesh the nodes that show it; -1: the root of the scene, for what belongs to no kept node.
    joints : tuple of tuple of int
        Joints of the asset's rig that carry these; empty where it has none.
    """

    tree: Tree
    of_position: np.ndarray
    placed: tuple[tuple[int, ...], ...]
    joints: tuple[tuple[int, ...], ...] = ()

    def world(self, node: int) -> np.ndarray:
        """From a node at rest to the space of the model, shape (4, 4)."""
        return self.tree.frame if node < 0 else self.tree.world()[node]

    def transformed(self, to_world: np.ndarray) -> Nodes:
        """Those of a model with an affine transform put in front of it."""
        return replace(self, tree=self.tree.transformed(to_world))

    def n_shown(self, position_faces: np.ndarray) -> int:
        """How many of some faces over welded positions are shown, those of instances counted each."""
        times = np.array([len(nodes) for nodes in self.placed])
        return int(times[self.of_position[position_faces[:, 0]]].sum())
