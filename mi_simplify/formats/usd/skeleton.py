"""
UsdSkel: skeletons, which meshes they are bound to, and all of them as one rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel

from ...errors import AssetError, MeshError
from ...machine import memory
from ...model.rig import Rig, Skin
from ..influences import STILL, make_skin, sorted_rig
from ..resources import Resources
from .motion import Motion, moves, with_parents
from .values import TIME, VISITED, matrix


@dataclass
class _Skeleton:
    """One skeleton of the stage: its joints are those from ``first`` on of the rig."""

    query: UsdSkel.SkeletonQuery
    joints: list[str]
    parents: np.ndarray
    bind: np.ndarray
    first: int


class Skeletons:
    """
    All skeletons that meshes of a stage are bound to; joints are numbered in the order in which they are met.

    Parameters
    ----------
    stage : Usd.Stage
    resources : Resources
        Takes the notes.
    to_world : ndarray, shape (4, 4)
        In front of everything: the up axis.
    """

    def __init__(self, stage: Usd.Stage, resources: Resources, to_world: np.ndarray):
        self.stage, self.resources, self.to_world = stage, resources, to_world
        self._cache = UsdSkel.Cache()
        self._xforms = UsdGeom.XformCache(TIME)
        self._roots: set = set()
        self._skeletons: dict[str, _Skeleton] = {}
        self._n = 0

    def query(self, prim: Usd.Prim) -> UsdSkel.SkinningQuery | None:
        """
        How a mesh is skinned; None where it is not, with a note where it looks as if it should be.

        Raises
        ------
        AssetError
            It is bound to a skeleton that does not exist.
        """
        root = UsdSkel.Root.Find(prim)
        binding = UsdSkel.BindingAPI(prim)
        name = prim.GetName()
        if not root:
            if binding.GetJointIndicesPrimvar().HasValue():
                self.resources.note(f"'{name}' has joint weights but no SkelRoot above it; it stands still")
            return None
        if root.GetPath() not in self._roots:
            self._roots.add(root.GetPath())
            self._cache.Populate(root, VISITED)
        query, skeleton = self._cache.GetSkinningQuery(prim), binding.GetInheritedSkeleton()
        if not skeleton:
            target = _inherited_target(prim)
            if target is not None:
                raise AssetError(
                    f"{self.resources.model.name}: '{name}' is bound to the skeleton '{target}', which does not exist; "
                    "bind it again and export"
                )
            if binding.GetJointIndicesPrimvar().HasValue():
                self.resources.note(f"'{name}' has joint weights but no skeleton; it stands still")
            return None
        if not query or not query.HasJointInfluences():
            self._check_influences(prim, binding)
            self.resources.note(f"'{name}' is bound to no joints; it stands still")
            return None
        return query

    def _check_influences(self, prim: Usd.Prim, binding: UsdSkel.BindingAPI) -> None:
        """Raise where a mesh has joints and weights that USD does not take."""
        joints, weights = binding.GetJointIndicesPrimvar(), binding.GetJointWeightsPrimvar()
        if joints.HasValue() or weights.HasValue():
            counts = [len(p.Get(TIME) or ()) if p.HasValue() else 0 for p in (joints, weights)]
            raise MeshError(
                f"{self.resources.model.name}: '{prim.GetName()}' has {counts[0]} joint indices and {counts[1]} "
                "weights that do not go together; bind it again and export"
            )

    def placement(self, prim: Usd.Prim, query: UsdSkel.SkinningQuery) -> np.ndarray:
        """
        World transform of a skinned mesh in its bind pose: it follows its skeleton instead of its parents.
        """
        skeleton = self._of(prim)
        return self.to_world @ self._at_rest(skeleton.query.GetPrim()) @ matrix(query.GetGeomBindTransform(TIME))

    def skin(self, prim: Usd.Prim, query: UsdSkel.SkinningQuery, points: np.ndarray) -> Skin:
        """
        Joints, numbered as in the rig, and weights of all points of a mesh.

        Raises
        ------
        AssetError
            It names a joint that the skeleton has not.
        MeshError
            Numbers of joints, weights and points do not go together.
        """
        skeleton, model, name = self._of(prim), self.resources.model.name, prim.GetName()
        found = query.ComputeVaryingJointInfluences(len(points), TIME)
        k = query.GetNumInfluencesPerComponent()
        joints, weights = (np.array(x) for x in found) if found else (np.zeros(0), np.zeros(0))
        if k < 1 or len(joints) != k * len(points) or len(weights) != len(joints):
            raise MeshError(
                f"{model}: '{name}' has {len(points)} points, but joint indices and weights for another number; "
                "bind it again and export"
            )
        order = query.GetJointOrder()
        local = list(order) if order else skeleton.joints
        number = {joint: j for j, joint in enumerate(skeleton.joints)}
        missing = [joint for joint in local if joint not in number]
        if missing:
            raise AssetError(
                f"{model}: '{name}' follows the joint '{missing[0]}', which skeleton "
                f"'{skeleton.query.GetPrim().GetName()}' does not have; bind it again and export"
            )
        if str(query.GetSkinningMethod()) == "dualQuaternion":
            self.resources.note(f"'{name}' asks for dual quaternions; it is skinned linearly")
        shape = (len(points), k)
        skin = make_skin(
            joints.reshape(shape), weights.reshape(shape), points, len(local), model, name, self.resources.note
        )
        return Skin(np.array([skeleton.first + number[joint] for joint in local])[skin.joints], skin.weights)

    def _of(self, prim: Usd.Prim) -> _Skeleton:
        """The skeleton of a mesh, read at its first use."""
        bound = UsdSkel.BindingAPI(prim).GetInheritedSkeleton()
        path, model = str(bound.GetPath()), self.resources.model.name
        if path in self._skeletons:
            return self._skeletons[path]
        name = bound.GetPrim().GetName()
        joints = [str(j) for j in bound.GetJointsAttr().Get() or ()]
        bind = bound.GetBindTransformsAttr().Get() or ()
        if not joints:
            raise AssetError(f"{model}: skeleton '{name}' has no joints; export it again")
        if len(bind) != len(joints):
            raise AssetError(
                f"{model}: skeleton '{name}' has {len(joints)} joints but {len(bind)} bind transforms; export it again"
            )
        query = self._cache.GetSkelQuery(bound)
        if not query or not query.GetTopology().Validate()[0]:
            raise AssetError(f"{model}: the joints of skeleton '{name}' do not form a tree; export it again")
        bind = np.stack([matrix(m) for m in bind])
        with np.errstate(all="ignore"):
            usable = np.isfinite(bind).all() and (np.abs(np.linalg.det(bind)) > 1e-30).all()
        if not usable:
            raise AssetError(f"{model}: a bind transform of skeleton '{name}' has no inverse; export it again")
        rest = bound.GetRestTransformsAttr().Get() or ()
        anim = query.GetAnimQuery()
        if len(rest) != len(joints) and not (anim and set(joints) <= {str(j) for j in anim.GetJointOrder()}):
            raise AssetError(
                f"{model}: skeleton '{name}' has {len(joints)} joints but {len(rest)} rest transforms, and no "
                "animation that moves them all; export it again"
            )
        self._tell(bound, anim, joints)
        parents = np.array(query.GetTopology().GetParentIndices(), np.int64)
        self._skeletons[path] = _Skeleton(query, joints, parents, bind, self._n)
        self._n += len(joints)
        return self._skeletons[path]

    def _tell(self, bound: UsdSkel.Skeleton, anim: UsdSkel.AnimQuery | None, joints: list[str]) -> None:
        """Notes on an animation that is not all that it could be."""
        name = bound.GetPrim().GetName()
        if not anim:
            self.resources.note(f"skeleton '{name}' has no animation; its one frame is the pose at rest")
            return
        moved = {str(j) for j in anim.GetJointOrder()}
        if not moved or not anim.ComputeJointLocalTransforms(TIME):
            self.resources.note(f"the animation of skeleton '{name}' is empty; its one frame is the pose at rest")
        elif still := [j for j in joints if j not in moved]:
            what = f"{len(still)} of {len(joints)} joints"
            self.resources.note(f"the animation of skeleton '{name}' leaves {what} at rest")

    def rig(self, rigid: list[Usd.Prim]) -> tuple[Rig, np.ndarray, list[int]]:
        """
        All joints and their motion.

        Parameters
        ----------
        rigid : list of Usd.Prim
            Meshes without a skin, which get joints of their own where they move, and share one where they do not.

        Returns
        -------
        rig : Rig
        new : ndarray, shape (J,)
            The rig's number of each joint that :meth:`skin` speaks of.
        joints : list of int
            That of each rigid mesh.
        """
        skeletons = list(self._skeletons.values())
        motion = Motion(self.stage, self.resources, [s.query for s in skeletons], rigid)
        n = len(motion.codes)
        what = f"{self.resources.model.name}: {n} frames of {self._n} joints"
        memory.require(512 * n * max(self._n, 1), what, "shorten the animation")
        several = len(skeletons) > 1
        names, parents, binds, poses = [], [], [], []
        for k, skeleton in enumerate(skeletons):
            prim = skeleton.query.GetPrim()
            prefix = f"{prim.GetName()}_{k}/" if several else ""
            names += [prefix + joint for joint in skeleton.joints]
            parents.append(np.where(skeleton.parents >= 0, skeleton.parents + skeleton.first, -1))
            binds.append(self._at_rest(prim) @ skeleton.bind)
            poses.append(motion.world(prim)[:, None] @ motion.joints(skeleton.query))
        joints: list[int] = []
        number: dict[str, int] = {}
        for prim in rigid:
            first = self._at_rest(prim)
            moving = moves(prim) and abs(np.linalg.det(first)) > 0
            path = str(prim.GetPath()) if moving else STILL
            if path not in number:
                number[path] = len(names)
                names.append(prim.GetName() if moving else STILL)
                parents.append(np.array([-1]))
                binds.append((first if moving else np.eye(4))[None])
                poses.append((motion.world(prim) if moving else np.tile(np.eye(4), (n, 1, 1)))[:, None])
            joints.append(number[path])
        bind, pose = np.concatenate(binds), np.concatenate(poses, axis=1)
        rate = self.stage.GetTimeCodesPerSecond() or 24.0
        rig, new = sorted_rig(names, np.concatenate(parents), bind, pose, motion.codes, rate, self.resources.model.name)
        return rig.transformed(self.to_world), new, [int(new[j]) for j in joints]

    def _at_rest(self, prim: Usd.Prim) -> np.ndarray:
        """World transform of a prim, shape (4, 4), without the up axis."""
        return matrix(self._xforms.GetLocalToWorldTransform(prim))


def _inherited_target(prim: Usd.Prim) -> str | None:
    """What the closest authored ``skel:skeleton`` on a prim or above it names."""
    for p in with_parents(prim):
        targets = UsdSkel.BindingAPI(p).GetSkeletonRel().GetTargets() if p.HasRelationship("skel:skeleton") else ()
        if targets:
            return str(targets[0])
    return None
