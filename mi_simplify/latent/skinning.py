"""
Linear blend skinning as a mesh operation: from the bind pose to a frame of the clip, with weights that are optimised.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..model.model import Model
from ..model.rig import BIND_POSE, bone_distances, bones, normal_matrices
from ..model.rigging import Rigging
from ..scenes.views import Views
from .surface import MeshTopology, Surface

#: What all joints together take of a vertex that none of them pulls at: a weight of 0 has no logarithm.
_LEAST = 1e-3


class Skinning:
    """
    ``v' = Σ_b w_b M_b v`` over all joints b (Hasselgren et al. 2021, Eq. 2), with ``w = softmax(logits)``.

    The softmax keeps weights positive and of sum 1; those that begin at 0 begin at a thousandth in sum, so that any
    joint may come to pull at any vertex. Normals and tangents of the posed mesh are those of the bind pose turned by
    the same weights, as viewers and engines turn those of a file: what is fitted is what they show.

    Parameters
    ----------
    model : Model
        Its positions are those of the bind pose.
    rigging : Rigging
        First weights.
    """

    def __init__(self, model: Model, rigging: Rigging):
        self.base = self.mesh = model.mesh
        self._rigging = rigging
        self._bones: list[mi.Float] = []
        self._n_joints, self._n_frames = rigging.weights.shape[1], rigging.rig.n_frames
        self.parameters: dict[str, np.ndarray] = {}
        self._weights = upload(mi.Float, rigging.weights.ravel())
        if len(rigging.fitted) > 1 and not rigging.rigid:  # a single pose says nothing of weights
            least = _LEAST / self._n_joints
            logits = np.log(np.maximum(rigging.weights, least))
            logits = logits if rigging.reach <= 0 else np.zeros_like(logits)  # the distance says it all
            self.parameters["skinning"] = logits.astype(np.float32).ravel()
        if rigging.reach > 0:
            owner, start, end = bones(rigging.rig)
            rank = np.array([np.sum(owner[:k] == joint) for k, joint in enumerate(owner)])
            table = np.zeros((int(rank.max()) + 1, self._n_joints, 8))
            for k in range(len(table)):  # of a joint with fewer bones its first one again
                table[k, owner[rank == 0]] = np.pad(np.hstack([start, end]), ((0, 0), (0, 2)))[rank == 0]
                table[k, owner[rank == k]] = np.pad(np.hstack([start, end]), ((0, 0), (0, 2)))[rank == k]
            self._bones = [upload(mi.Float, rows.ravel()) for rows in table]
        moves = np.stack([rigging.rig.matrices(frame) for frame in (*range(self._n_frames), BIND_POSE)])
        turns = np.zeros_like(moves)
        turns[:, :, :3, :3] = np.stack([normal_matrices(m) for m in moves])
        self._moves, self._turns = (upload(mi.Float, m[:, :, :3].ravel()) for m in (moves, turns))  # (T + 1, J, 3, 4)
        self._position_index = upload(mi.UInt32, model.mesh.position_index)

    def positions(self, base: mi.Float, parameters: dict[str, mi.Float], views: Views) -> mi.Float:
        """See :class:`.operation.MeshOperation`."""
        weights = self._of(parameters, base)
        lane = dr.arange(mi.UInt32, dr.width(weights))  # one for each joint of each position
        position = lane // self._n_joints
        v = dr.gather(mi.Point3f, base, position)
        return dr.ravel(mi.Point3f(self._blend(self._moves, weights, lane - position * self._n_joints, v, views, 1)))

    def surface(
        self, topology: MeshTopology, positions: mi.Float, base: mi.Float, parameters: dict[str, mi.Float], views: Views
    ) -> Surface:
        """See :class:`.operation.MeshOperation`."""
        n, lanes = self._n_joints, dr.arange(mi.UInt32, topology.n_vertices * self._n_joints)
        vertex = lanes // n
        joint = lanes - vertex * n
        place = dr.gather(mi.UInt32, self._position_index, vertex)
        weights = dr.gather(mi.Float, self._of(parameters, base), place * n + joint)
        rest = topology.surface(base).packets
        own = dr.arange(mi.UInt32, topology.n_vertices)
        p = dr.gather(mi.Point3f, positions, dr.gather(mi.UInt32, self._position_index, own))
        _, n_rest, t_rest = (dr.gather(mi.Vector4f, rest, 3 * own + k) for k in range(3))
        u = dr.gather(mi.Float, rest, 12 * own + 3)
        normal, tangent = (
            mi.Vector3f(self._blend(table, weights, joint, dr.gather(mi.Vector4f, rest, 3 * vertex + k).xyz, views, 0))
            for table, k in ((self._turns, 1), (self._moves, 2))
        )
        normal = _unit(normal, n_rest.xyz)
        tangent = _unit(tangent - normal * dr.dot(normal, tangent), t_rest.xyz)
        packets = dr.ravel(mi.ArrayXf([*p, u, *normal, n_rest.w, *tangent, t_rest.w]))
        return Surface(packets, topology.faces)

    def _blend(
        self, table: mi.Float, weights: mi.Float, joint: mi.UInt32, v: mi.Vector3f, views: Views, w: int
    ) -> list[mi.Float]:
        """``Σ_b w_b M_b (v, w)`` in the views' frame: one lane a joint becomes one for what it pulls at."""
        frame = dr.gather(mi.Float, views.frame, 0)
        frame = dr.select(frame < 0, self._n_frames, mi.UInt32(dr.clip(frame, 0, self._n_frames - 1) + 0.5))
        out = []
        for k in range(3):
            row = dr.gather(mi.Vector4f, table, 3 * (frame * self._n_joints + joint) + k)
            out.append(dr.block_sum(weights * (dr.dot(row.xyz, v) + row.w * w), self._n_joints))
        return out

    def _of(self, parameters: dict[str, mi.Float], base: mi.Float) -> mi.Float:
        if not parameters:
            return self._weights
        logits = parameters["skinning"]
        return self.weights(logits + self._following(dr.detach(base)) if self._bones else logits)

    def _following(self, base: mi.Float) -> mi.Float:
        """:meth:`_prior` of positions on the device."""
        n = self._n_joints
        lane = dr.arange(mi.UInt32, dr.width(base) // 3 * n)
        position = lane // n
        joint = lane - position * n
        v, distance2 = dr.gather(mi.Point3f, base, position), mi.Float(dr.inf)
        for table in self._bones:
            a, b = (dr.gather(mi.Vector4f, table, 2 * joint + k) for k in range(2))
            start, end = mi.Point3f(a.x, a.y, a.z), mi.Point3f(a.w, b.x, b.y)
            way = end - start
            share = dr.clip(dr.dot(v - start, way) / dr.maximum(dr.squared_norm(way), 1e-12), 0, 1)
            distance2 = dr.minimum(distance2, dr.squared_norm(v - start - way * share))
        return dr.sqrt(distance2) * dr.opaque(mi.Float, -1 / self._rigging.reach)

    def _prior(self, positions: np.ndarray) -> np.ndarray:
        """What follows the positions in the logarithms of the weights, shape (P, J) or 0."""
        if self._rigging.reach <= 0:
            return np.zeros(1)
        return -bone_distances(self._rigging.rig, positions) / self._rigging.reach

    def weights(self, logits: mi.Float) -> mi.Float:
        """
        Weights of all joints for each position, flat, width P·J.
        """
        n = self._n_joints
        position = dr.arange(mi.UInt32, dr.width(logits)) // n
        largest = dr.block_reduce(dr.ReduceOp.Max, dr.detach(logits), n)
        e = dr.exp(logits - dr.gather(mi.Float, largest, position))
        return e / dr.gather(mi.Float, dr.block_sum(e, n), position)

    def written(self, model: Model, parameters: dict[str, np.ndarray]) -> Model:
        """See :class:`.operation.MeshOperation`."""
        if not parameters:
            return model
        logits = np.asarray(parameters["skinning"], np.float64).reshape(-1, self._n_joints)
        logits = logits + self._prior(model.mesh.positions)
        e = np.exp(logits - logits.max(1, keepdims=True))
        weights = (e / e.sum(1, keepdims=True)).astype(np.float32)
        return replace(model, skin=replace(self._rigging, weights=weights, reach=0.0))


def _unit(v: mi.Vector3f, otherwise: mi.Vector3f) -> mi.Vector3f:
    """Unit vectors; where there is no length, others, without a gradient."""
    length2 = dr.squared_norm(v)
    return dr.select(length2 > 1e-12, v * dr.rsqrt(dr.maximum(length2, 1e-12)), dr.detach(otherwise))
