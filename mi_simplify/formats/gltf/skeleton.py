"""
glTF skins: joints, which are nodes, as one rig.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import AssetError, MeshError
from ...machine import memory
from ...model.rig import Rig, Skin
from ..influences import STILL, make_skin, sorted_rig
from ..validate import MAX_COORDINATE
from .file import GltfFile
from .motion import RATE, Motion


class Skeletons:
    """
    All skins of a file as one rig; joints are numbered in the order in which they are met.

    A joint with another inverse bind matrix in another skin counts as another one.

    Parameters
    ----------
    file : GltfFile
    parents : dict of int to int
        Node above each node of the scene, -1 for none; parents before children.
    world : dict of int to ndarray, shape (4, 4)
        Transforms of all nodes at rest.
    """

    def __init__(self, file: GltfFile, parents: dict[int, int], world: dict[int, np.ndarray]):
        self.file, self.parents, self.world = file, parents, world
        self._numbers: dict[tuple[int, bytes], int] = {}
        self._nodes: list[int] = []
        self._binds: list[np.ndarray] = []
        self._skins: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.motion = Motion(file, parents)

    def of(self, index: int, name: str) -> tuple[np.ndarray, np.ndarray]:
        """
        The rig's numbers of a skin's joints, shape (J,), and where its meshes stand in the bind pose, shape (4, 4).

        That is where the first joint without a joint above it carries them at rest.

        Raises
        ------
        AssetError
            Joints are missing, or a matrix has no inverse.
        """
        if index in self._skins:
            return self._skins[index]
        file, skin = self.file, self.file.item("skins", index)
        joints = skin.get("joints", [])
        if not joints or not all(j in self.world for j in joints):
            raise AssetError(f"{file.name}: the skin of '{name}' has joints that are not in the scene; export it again")
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if skin.get("inverseBindMatrices") is not None:
            rows = file.accessor(skin["inverseBindMatrices"]).astype(np.float64)
            if len(rows) < len(joints):
                raise AssetError(
                    f"{file.name}: the skin of '{name}' has {len(joints)} joints but {len(rows)} inverse bind "
                    "matrices; export it again"
                )
            inverse = rows[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        rest = np.stack([self.world[j] for j in joints])
        if not (np.isfinite(inverse).all() and (np.abs(rest @ inverse) < MAX_COORDINATE).all()):
            raise MeshError(f"{file.name}: the skin of '{name}' is not finite; reset its pose and export again")
        if (np.abs(np.linalg.det(inverse)) < 1e-30).any():
            raise AssetError(f"{file.name}: a bind matrix of the skin of '{name}' has no inverse; export it again")
        root = next(k for k, j in enumerate(joints) if self._above(j, set(joints)) < 0)
        placement = rest[root] @ inverse[root]
        if abs(np.linalg.det(placement)) < 1e-30:
            placement = np.eye(4)
        numbers = []
        for j, matrix in zip(joints, placement @ np.linalg.inv(inverse), strict=True):
            key = j, matrix.astype(np.float32).tobytes()
            if key not in self._numbers:
                self._numbers[key] = len(self._nodes)
                self._nodes.append(j)
                self._binds.append(matrix)
            numbers.append(self._numbers[key])
        self._skins[index] = np.array(numbers), placement
        return self._skins[index]

    def skin(self, index: int, joints: np.ndarray, weights: np.ndarray, points: np.ndarray, name: str) -> Skin:
        """
        The skin of a primitive, of joints (V, K) and weights (V, K) as the file has them.
        """
        if not np.isfinite(weights).all():
            raise MeshError(f"{self.file.name}: the skin of '{name}' is not finite; reset its pose and export again")
        numbers, _ = self.of(index, name)
        note = self.file.resources.note
        skin = make_skin(joints, weights, points, len(numbers), self.file.name, name, note)
        return Skin(numbers[skin.joints], skin.weights)

    def _above(self, node: int, joints: set[int]) -> int:
        """The closest of some joints above a node, -1 for none."""
        node = self.parents[node]
        while node >= 0 and node not in joints:
            node = self.parents[node]
        return node

    def rig(self, carriers: list[int]) -> tuple[Rig, np.ndarray, list[int]]:
        """
        All joints and their motion.

        Parameters
        ----------
        carriers : list of int
            Nodes of meshes without a skin, which become joints where they move, and share one where they do not.

        Returns
        -------
        rig : Rig
        new : ndarray, shape (J,)
            The rig's number of each joint that :meth:`skin` speaks of.
        joints : list of int
            That of each carrier.
        """
        motion, n = self.motion, len(self.motion.times)
        if not motion.clips:
            self.file.resources.note("the skeleton has no animation; its one frame is the pose at rest")
        what = f"{self.file.name}: {n} frames of {len(self._nodes)} joints"
        memory.require(512 * n * len(self.parents), what, "shorten the animation")
        nodes, binds, joints = list(self._nodes), list(self._binds), []
        number: dict[int, int] = {}
        for node in carriers:
            usable = abs(np.linalg.det(self.world[node])) > 1e-30
            key = node if usable and motion.moves(node) else -1
            if key not in number:
                number[key] = len(nodes)
                nodes.append(key)
                binds.append(np.eye(4) if key < 0 else self.world[node])
            joints.append(number[key])
        world = motion.world({node for node in nodes if node >= 0})
        poses = np.stack([np.tile(np.eye(4), (n, 1, 1)) if j < 0 else world[j] for j in nodes], axis=1)
        first = {node: k for k, node in reversed(list(enumerate(nodes)))}
        above = [self._above(j, set(first) - {-1}) if j >= 0 else -1 for j in nodes]
        parents = np.array([first[a] if a >= 0 else -1 for a in above])
        names = [STILL if j < 0 else self.file.item("nodes", j).get("name") or f"node_{j}" for j in nodes]
        rig, new = sorted_rig(names, parents, np.stack(binds), poses, motion.times * RATE, RATE, self.file.name)
        return replace(rig, clips=motion.clips), new, [int(new[j]) for j in joints]
