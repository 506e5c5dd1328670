"""
glTF skins and animations: joints, which are nodes, and how nodes move.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..errors import AssetError, MeshError
from ..machine import memory
from .gltf_file import GltfFile
from .influences import STILL, make_skin, sorted_rig
from .rig import Rig, Skin
from .validate import MAX_COORDINATE

#: How frames are numbered, and how often sparse keys are sampled [1/s].
RATE = 24.0

#: Frames of a clip; longer ones are thinned.
MAX_FRAMES = 2000


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
        motion = Motion(self.file, self.parents)
        n = len(motion.times)
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
        if not (np.isfinite(poses).all() and np.abs(poses).max() < MAX_COORDINATE):
            raise AssetError(f"{self.file.name}: the animation is not finite; export it again")
        first = {node: k for k, node in reversed(list(enumerate(nodes)))}
        above = [self._above(j, set(first) - {-1}) if j >= 0 else -1 for j in nodes]
        parents = np.array([first[a] if a >= 0 else -1 for a in above])
        names = [STILL if j < 0 else self.file.item("nodes", j).get("name") or f"node_{j}" for j in nodes]
        rig, new = sorted_rig(names, parents, np.stack(binds), poses, motion.times * RATE, RATE)
        return rig, new, [int(new[j]) for j in joints]


class Motion:
    """
    The first animation of a file: local transforms of nodes over time.

    Parameters
    ----------
    file : GltfFile
    parents : dict of int to int
        Node above each node of the scene, -1 for none.
    """

    def __init__(self, file: GltfFile, parents: dict[int, int]):
        self.file, self.parents = file, parents
        self._curves: dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]] = {}
        animations = file.json.get("animations") or []
        if len(animations) > 1:
            name = animations[0].get("name") or "the first"
            file.resources.note(f"of {len(animations)} animations '{name}' was taken; the others were left out")
        for channel in (animations[0].get("channels") or []) if animations else ():
            self._add(channel, animations[0]["samplers"])
        if not self._curves:
            file.resources.note("the skeleton has no animation; its one frame is the pose at rest")
        self.times = self._times()

    def _add(self, channel: dict, samplers: list[dict]) -> None:
        target, sampler = channel.get("target") or {}, samplers[channel["sampler"]]
        node, path = target.get("node"), target.get("path")
        if node not in self.parents or path not in _WIDTHS:
            return
        times = self.file.accessor(sampler["input"]).astype(np.float64).reshape(-1)
        values = self.file.accessor(sampler["output"]).astype(np.float64)
        kind = sampler.get("interpolation", "LINEAR")
        rows = len(times) * (3 if kind == "CUBICSPLINE" else 1)
        if not len(times) or values.shape != (rows, _WIDTHS[path]):
            found = f"{len(times)} keys but values of shape {values.shape}"
            raise AssetError(f"{self.file.name}: an animation has {found}; export it again")
        if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) >= 0).all()):
            raise AssetError(f"{self.file.name}: the animation is not finite or runs backwards; export it again")
        self._curves[node, path] = times, values, kind

    def _times(self) -> np.ndarray:
        """Seconds of the frames: those of the keys, and more between keys that lie far apart."""
        if not self._curves:
            return np.zeros(1)
        keys = np.unique(np.concatenate([t for t, _, _ in self._curves.values()]))
        keys = keys[np.diff(keys, prepend=-np.inf) > _SAME_TIME]
        if len(keys) > 1 and np.diff(keys).max() > 1.5 / RATE and np.ptp(keys) * RATE <= MAX_FRAMES:
            keys = np.unique(np.concatenate([keys, np.arange(keys[0], keys[-1], 1 / RATE)]))
            keys = keys[np.diff(keys, prepend=-np.inf) > _SAME_TIME]
        if len(keys) > MAX_FRAMES:
            step = -(-len(keys) // MAX_FRAMES)
            self.file.resources.note(f"of {len(keys)} frames every {step}th was taken")
            keys = keys[::step]
        return keys

    def moves(self, node: int) -> bool:
        """
        Whether a node or one above it is animated.
        """
        while node >= 0:
            if any((node, path) in self._curves for path in _WIDTHS):
                return True
            node = self.parents[node]
        return False

    def world(self, nodes: Iterable[int]) -> dict[int, np.ndarray]:
        """
        Transforms of nodes, and of those above them, in every frame, shape (T, 4, 4) each.
        """
        needed: set[int] = set()
        for node in nodes:
            while node >= 0 and node not in needed:
                needed.add(node)
                node = self.parents[node]
        out: dict[int, np.ndarray] = {-1: np.eye(4)}
        for node, parent in self.parents.items():
            if node in needed:
                out[node] = out[parent] @ self._local(node)
        n = len(self.times)
        return {node: np.broadcast_to(matrices, (n, 4, 4)) for node, matrices in out.items()}

    def _local(self, index: int) -> np.ndarray:
        """A node's own transform in every frame, shape (T, 4, 4), or (1, 4, 4) where it does not move."""
        node = self.file.item("nodes", index)
        if not any((index, path) in self._curves for path in _WIDTHS):
            return local_matrix(node)[None]
        n = len(self.times)
        columns: list[np.ndarray | None] = []
        for path in _WIDTHS:
            if (index, path) in self._curves:
                columns.append(_sampled(*self._curves[index, path], self.times, path == "rotation"))
            else:
                value = node.get(path)
                columns.append(None if value is None else np.tile(np.array(value, np.float64), (n, 1)))
        return trs(n, *columns)


#: Keys closer than this are of one frame [s].
_SAME_TIME = 1e-4

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


def _sampled(keys: np.ndarray, values: np.ndarray, kind: str, times: np.ndarray, rotation: bool) -> np.ndarray:
    """Values of a curve at other times, shape (T, C); glTF 2.0 Appendix C."""
    t = np.clip(times, keys[0], keys[-1])
    k = np.clip(np.searchsorted(keys, t, side="right") - 1, 0, max(len(keys) - 2, 0))
    after = np.minimum(k + 1, len(keys) - 1)
    length = keys[after] - keys[k]
    share = (t - keys[k]) / np.where(length > 0, length, 1)
    if kind == "STEP":
        return values[np.clip(np.searchsorted(keys, t + _SAME_TIME, side="right") - 1, 0, len(keys) - 1)]
    if kind == "CUBICSPLINE":
        values = values.reshape(len(keys), 3, -1)
        s, h = share[:, None], length[:, None]
        return (
            (2 * s**3 - 3 * s**2 + 1) * values[k, 1] + h * (s**3 - 2 * s**2 + s) * values[k, 2]
            + (3 * s**2 - 2 * s**3) * values[after, 1] + h * (s**3 - s**2) * values[after, 0]
        )  # fmt: skip
    if rotation and len(keys) > 1 and (np.diff(keys) > 0).all():
        length = np.linalg.norm(values, axis=1, keepdims=True)
        unit = np.where(length > 0, values / np.where(length > 0, length, 1), [0, 0, 0, 1])
        return Slerp(keys, Rotation.from_quat(unit))(t).as_quat()
    return values[k] + (values[after] - values[k]) * share[:, None]


def local_matrix(node: dict) -> np.ndarray:
    """
    A node's own transform, shape (4, 4).
    """
    if node.get("matrix") is not None:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    return trs(1, *(None if node.get(k) is None else np.array([node[k]], np.float64) for k in _WIDTHS))[0]


def trs(n: int, translation: np.ndarray | None, rotation: np.ndarray | None, scale: np.ndarray | None) -> np.ndarray:
    """
    Matrices of translations (N, 3), unit quaternions xyzw (N, 4) and scales (N, 3); shape (N, 4, 4).
    """
    out = np.tile(np.eye(4), (n, 1, 1))
    if rotation is not None:
        x, y, z, w = (rotation / np.maximum(np.linalg.norm(rotation, axis=1, keepdims=True), 1e-20)).T
        out[:, :3, :3] = np.moveaxis(np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]), -1, 0)  # fmt: skip
    if scale is not None:
        out[:, :3, :3] *= scale[:, None, :]
    if translation is not None:
        out[:, :3, 3] = translation
    return out
