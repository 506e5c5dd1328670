"""
Skeletons in plain NumPy: joints, how they move over a clip, and which of them pull at which vertex.

Linear blend skinning (Hasselgren et al. 2021, Eq. 2): ``v' = Σ_b w_b M_b v``, ``M_b`` from the bind pose to a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

#: The number that stands for the bind pose where a frame is asked for.
BIND_POSE = -1


@dataclass(frozen=True)
class Skin:
    """
    What pulls at the vertices of a part: K joints each.

    Parameters
    ----------
    joints : ndarray, shape (V, K), int64
        Joints of the asset's rig.
    weights : ndarray, shape (V, K), float64
        Not negative, of sum 1; 0 where fewer than K joints pull.
    """

    joints: np.ndarray
    weights: np.ndarray

    def matrix(self, n_joints: int) -> csr_array:
        """
        The weights as a sparse matrix, shape (V, J).
        """
        n, k = self.joints.shape
        rows = np.repeat(np.arange(n), k)
        return csr_array((self.weights.ravel(), (rows, self.joints.ravel())), shape=(n, n_joints))

    def taken(self, index: np.ndarray) -> Skin:
        """
        That of the vertices of these indices.
        """
        return Skin(self.joints[index], self.weights[index])


@dataclass(frozen=True)
class Rig:
    """
    Joints and one clip of their motion; all matrices are for column vectors, in the frame of the asset.

    Parameters
    ----------
    names : tuple of str
        Of the joints; no two are alike.
    parents : ndarray, shape (J,), int64
        Joint above each, which comes before it; -1 for none.
    bind : ndarray, shape (J, 4, 4), float64
        Joint to world in the bind pose, in which the asset's instances stand.
    poses : ndarray, shape (T, J, 4, 4), float64
        Joint to world in every frame of the clip.
    codes : ndarray, shape (T,), float64
        How the file numbers these frames (USD: time codes), rising.
    rate : float
        Codes a second.
    clips : tuple of (str, int, int)
        What the frames are of, where they are several animations one after the other, or one with a name: its name, its
        first frame, and the one after its last.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    bind: np.ndarray
    poses: np.ndarray
    codes: np.ndarray
    rate: float = 24.0
    clips: tuple[tuple[str, int, int], ...] = ()

    @property
    def n_frames(self) -> int:
        """Frames T of the clip; 1 where nothing moves: the pose at rest."""
        return len(self.codes)

    @property
    def times(self) -> np.ndarray:
        """Seconds since the first frame, shape (T,)."""
        return (self.codes - self.codes[0]) / self.rate

    def matrices(self, frame: float) -> np.ndarray:
        """
        ``M_b`` from the bind pose to a frame, shape (J, 4, 4).

        Parameters
        ----------
        frame : float
            Index into the clip, 0 to T - 1; between two frames the matrices are interpolated linearly. Negative: the
            bind pose, where all are the identity.
        """
        if frame < 0:
            return np.broadcast_to(np.eye(4), self.bind.shape)
        low = min(int(frame), self.n_frames - 1)
        high = min(low + 1, self.n_frames - 1)
        pose = self.poses[low] + (self.poses[high] - self.poses[low]) * (frame - low)
        return pose @ np.linalg.inv(self.bind)

    def frame_at(self, seconds: float) -> float:
        """
        The frame, with a fraction, at a time since the first one; the last one beyond the end.
        """
        return float(np.interp(seconds, self.times, np.arange(self.n_frames)))

    def transformed(self, to_world: np.ndarray) -> Rig:
        """
        The rig of an asset with an affine transform, shape (4, 4), put in front of everything.
        """
        return replace(self, bind=to_world @ self.bind, poses=to_world @ self.poses)

    def clip(self, frames: np.ndarray) -> Rig:
        """
        The same skeleton with these frames alone.
        """
        kept = np.zeros(self.n_frames, bool)
        kept[frames] = True
        before = np.concatenate([[0], np.cumsum(kept)])
        clips = tuple((name, int(before[first]), int(before[last])) for name, first, last in self.clips)
        return replace(self, poses=self.poses[frames], codes=self.codes[frames], clips=clips)


def deform(vertices: np.ndarray, skin: Skin, matrices: np.ndarray) -> np.ndarray:
    """
    Vertices (V, 3) after ``Σ_b w_b M_b``, with matrices of shape (J, 4, 4).
    """
    flat = np.asarray(matrices)[:, :3].reshape(len(matrices), 12)
    blend = (skin.matrix(len(matrices)) @ flat).reshape(-1, 3, 4)
    return np.einsum("vij,vj->vi", blend[:, :, :3], vertices) + blend[:, :, 3]


def turn(vectors: np.ndarray, skin: Skin, linear: np.ndarray) -> np.ndarray:
    """
    Unit vectors (V, 3) after ``Σ_b w_b L_b``, shape (J, 3, 3), made unit again; one that cancels stays as it was.
    """
    blend = (skin.matrix(len(linear)) @ linear.reshape(-1, 9)).reshape(-1, 3, 3)
    turned = np.einsum("vij,vj->vi", blend, vectors)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.where(length > 1e-12, turned / np.maximum(length, 1e-12), vectors).astype(np.float32)


def normal_matrices(matrices: np.ndarray) -> np.ndarray:
    """
    What turns normals under joint matrices (J, 4, 4): their inverse transposes, as USD and glTF have it; (J, 3, 3).

    Where there is no inverse the cofactors, which are the same but for their length.
    """
    linear = np.asarray(matrices)[:, :3, :3]
    cofactors = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
    size = np.abs(np.linalg.det(linear))[:, None, None]
    return cofactors / np.where(size > 1e-12, size, 1)


def bones(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Bones in the bind pose: from each joint to its children; a joint without any is a point.

    Returns
    -------
    owner : ndarray, shape (S,), int64
        Joint that moves each bone.
    start, end : ndarray, shape (S, 3)
    """
    joints = rig.bind[:, :3, 3]
    child = np.flatnonzero(rig.parents >= 0)
    leaves = np.setdiff1d(np.arange(len(joints)), rig.parents[child])
    owner = np.concatenate([rig.parents[child], leaves])
    return owner, joints[owner], joints[np.concatenate([child, leaves])]


def bone_distances(rig: Rig, positions: np.ndarray) -> np.ndarray:
    """
    Distance of positions (P, 3) to the closest bone of each joint in the bind pose, shape (P, J).
    """
    owner, start, end = bones(rig)
    way = end - start
    share = np.einsum("psi,si->ps", positions[:, None] - start, way) / np.maximum((way**2).sum(1), 1e-30)
    nearest = start + np.clip(share, 0, 1)[..., None] * way
    distance = np.linalg.norm(positions[:, None] - nearest, axis=2)  # (P, S)
    out = np.full((len(positions), len(rig.names)), np.inf)
    np.minimum.at(out.T, owner, distance.T)
    return out
