"""
glTF animations: how nodes move, and the matrices of nodes.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ...errors import AssetError
from ...model.tree import Tree
from ..influences import MAX_FRAMES
from .file import GltfFile

#: How frames are numbered, and how often sparse keys are sampled [1/s].
RATE = 24.0


class Motion:
    """
    The animations of a file, one after the other: transforms of nodes over time.

    Parameters
    ----------
    file : GltfFile
    parents : dict of int to int
        Node above each node of the scene, -1 for none.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Seconds of the frames; each animation begins a frame after the end of the one before.
    clips : tuple of (str, int, int)
        Of each animation its name, its first frame, and the one after its last.
    """

    def __init__(self, file: GltfFile, parents: dict[int, int]):
        self._file, self.parents = file, parents
        found = [_Clip(file, parents, animation) for animation in file.json.get("animations") or []]
        self._clips = [clip for clip in found if clip.curves]
        times: list[np.ndarray] = []
        clips: list[tuple[str, int, int]] = []
        n = 0
        for k, clip in enumerate(self._clips):
            shift = times[-1][-1] + 1 / RATE - clip.times[0] if times else 0.0
            clips.append((clip.name or f"clip {k}", n, n + len(clip.times)))
            times.append(clip.times + shift)
            n += len(clip.times)
        self.times: np.ndarray = np.concatenate(times) if times else np.zeros(1)
        self.clips = tuple(clips)

    def moves(self, node: int) -> bool:
        """
        Whether a node or one above it is animated.
        """
        while node >= 0:
            if self._animated(node):
                return True
            node = self.parents[node]
        return False

    def _animated(self, node: int) -> bool:
        return any((node, path) in clip.curves for clip in self._clips for path in _WIDTHS)

    def tree(self) -> Tree:
        """
        The nodes of the scene, with the transforms of those that are animated in every frame.
        """
        nodes = list(self.parents)
        number = {node: k for k, node in enumerate(nodes)}
        moving = [node for node in nodes if self._animated(node)]
        motion = np.zeros((len(self.times), len(moving), 4, 4))
        for k, node in enumerate(moving):
            motion[:, k] = np.concatenate([clip.local(node) for clip in self._clips])
        entries = [self._file.item("nodes", node) for node in nodes]
        return Tree(
            tuple(str(entry.get("name") or "") for entry in entries),
            np.array([number.get(parent, -1) for parent in self.parents.values()], np.int64),
            np.array([local_matrix(entry) for entry in entries]).reshape(-1, 4, 4),
            np.array([number[node] for node in moving], np.int64),
            motion,
        )

    def world(self, nodes: Iterable[int]) -> dict[int, np.ndarray]:
        """
        Transforms of nodes, and of those above them, in every frame, shape (T, 4, 4) each.
        """
        needed = set()
        for node in nodes:
            while node >= 0 and node not in needed:
                needed.add(node)
                node = self.parents[node]
        if not self._clips:
            return self._still(needed)
        parts = [clip.world(needed) for clip in self._clips]
        return {node: np.concatenate([part[node] for part in parts]) for node in parts[0]}

    def _still(self, needed: set[int]) -> dict[int, np.ndarray]:
        return _Clip(self._file, self.parents, {}).world(needed)


class _Clip:
    """One animation: local transforms of nodes over time."""

    def __init__(self, file: GltfFile, parents: dict[int, int], animation: dict):
        self.file, self.parents, self.name = file, parents, animation.get("name")
        self.curves: dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]] = {}
        for channel in animation.get("channels") or []:
            self._add(channel, animation["samplers"])
        self.times = self._times()

    def _add(self, channel: dict, samplers: list[dict]) -> None:
        target, sampler = channel.get("target") or {}, samplers[channel["sampler"]]
        node, path = target.get("node"), target.get("path")
        if path == "weights":
            self.file.resources.note("the animation of morph weights was left out")
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
        self.curves[node, path] = times, values, kind

    def _times(self) -> np.ndarray:
        """Seconds of the frames: those of the keys, and more between keys that lie far apart."""
        if not self.curves:
            return np.zeros(1)
        keys = np.unique(np.concatenate([t for t, _, _ in self.curves.values()]))
        keys = keys[np.diff(keys, prepend=-np.inf) > _SAME_TIME]
        if len(keys) > 1 and np.diff(keys).max() > 1.5 / RATE and np.ptp(keys) * RATE <= MAX_FRAMES:
            keys = np.unique(np.concatenate([keys, np.arange(keys[0], keys[-1], 1 / RATE)]))
            keys = keys[np.diff(keys, prepend=-np.inf) > _SAME_TIME]
        if len(keys) > MAX_FRAMES:
            step = -(-len(keys) // MAX_FRAMES)
            self.file.resources.note(f"of {len(keys)} frames one in {step} was taken")
            keys = keys[::step]
        return keys

    def world(self, needed: set[int]) -> dict[int, np.ndarray]:
        """Transforms of nodes, shape (T, 4, 4) each; what is above a node is among them."""
        out: dict[int, np.ndarray] = {-1: np.eye(4)}
        for node, parent in self.parents.items():
            if node in needed:
                out[node] = out[parent] @ self._local(node)
        n = len(self.times)
        return {node: np.broadcast_to(matrices, (n, 4, 4)) for node, matrices in out.items()}

    def local(self, node: int) -> np.ndarray:
        """A node's own transform in every frame, shape (T, 4, 4)."""
        return np.broadcast_to(self._local(node), (len(self.times), 4, 4))

    def _local(self, index: int) -> np.ndarray:
        """A node's own transform in every frame, shape (T, 4, 4), or (1, 4, 4) where it does not move."""
        node = self.file.item("nodes", index)
        if not any((index, path) in self.curves for path in _WIDTHS):
            return local_matrix(node)[None]
        n = len(self.times)
        columns: list[np.ndarray | None] = []
        for path in _WIDTHS:
            if (index, path) in self.curves:
                columns.append(_sampled(*self.curves[index, path], self.times, path == "rotation"))
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


def scene_nodes(file: GltfFile) -> tuple[dict[int, np.ndarray], dict[int, int]]:
    """
    Transforms of all nodes of the default scene, by node, parents before children; and the node above each, or -1.

    Raises
    ------
    AssetError
        A node has two parents or lies on a loop.
    """
    json = file.json
    if json.get("scenes"):
        roots = file.item("scenes", json.get("scene", 0)).get("nodes", [])
    else:
        nodes = json.get("nodes", [])
        roots = sorted(set(range(len(nodes))) - {c for n in nodes for c in n.get("children", [])})
    world: dict[int, np.ndarray] = {}
    parents: dict[int, int] = {}
    todo = [(root, -1, np.eye(4)) for root in reversed(roots)]
    while todo:
        index, above, parent = todo.pop()
        if index in world:
            raise AssetError(f"{file.name}: nodes[{index}] has two parents or lies on a loop; export it again")
        node = file.item("nodes", index)
        world[index], parents[index] = parent @ local_matrix(node), above
        todo += [(child, index, world[index]) for child in reversed(node.get("children", []))]
    return world, parents


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
