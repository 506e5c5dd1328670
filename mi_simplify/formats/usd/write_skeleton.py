"""
UsdSkel out: a skeleton, its animation, and the weights that bind a mesh to it.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Tf, Usd, UsdGeom, UsdSkel, Vt

from ...model.mesh import Mesh
from ...model.rig import deform
from ...model.rigging import Rigging
from ...model.skeleton import Skeleton, influences, skeleton_of


def bind_skeleton(stage: Usd.Stage, root: UsdSkel.Root, prim: UsdGeom.Mesh, mesh: Mesh, rigging: Rigging) -> None:
    """
    Give the mesh below a SkelRoot a skeleton, with the clip as its animation.

    Parameters
    ----------
    stage : Usd.Stage
    root : UsdSkel.Root
        Gets the extent of the character in every frame.
    prim : UsdGeom.Mesh
        With the welded positions of ``mesh`` as its points.
    mesh : Mesh
    rigging : Rigging
    """
    rig, skeleton = rigging.rig, skeleton_of(rigging.rig)
    joints = _paths(skeleton)
    path = root.GetPath().AppendChild("skeleton")
    usd = UsdSkel.Skeleton.Define(stage, path)
    usd.CreateJointsAttr(joints)
    usd.CreateBindTransformsAttr(_matrices(skeleton.bind))
    animation = UsdSkel.Animation.Define(stage, path.AppendChild("animation"))
    animation.CreateJointsAttr(joints)
    attributes = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr(), animation.CreateScalesAttr()
    still = rig.n_frames == 1
    for k, code in enumerate(rig.codes):
        x, y, z, w = skeleton.rotations[k].T
        values = (
            Vt.Vec3fArray.FromNumpy(skeleton.translations[k]),
            Vt.QuatfArray([Gf.Quatf(*map(float, q)) for q in zip(w, x, y, z, strict=True)]),
            Vt.Vec3hArray.FromNumpy(skeleton.scales[k].astype(np.float16)),
        )
        for attribute, value in zip(attributes, values, strict=True):
            attribute.Set(value, Usd.TimeCode.Default() if still else Usd.TimeCode(float(code)))
    rest = UsdSkel.MakeTransforms(*(a.Get(Usd.TimeCode.EarliestTime()) for a in attributes))
    usd.CreateRestTransformsAttr(rest)
    UsdSkel.BindingAPI.Apply(usd.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])

    which, weights = influences(rigging)
    binding = UsdSkel.BindingAPI.Apply(prim.GetPrim())
    binding.CreateSkeletonRel().SetTargets([path])
    k = which.shape[1]
    binding.CreateJointIndicesPrimvar(False, k).Set(Vt.IntArray.FromNumpy(which.astype(np.int32).ravel()))
    binding.CreateJointWeightsPrimvar(False, k).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    if not still:
        stage.SetStartTimeCode(float(rig.codes[0]))
        stage.SetEndTimeCode(float(rig.codes[-1]))
        stage.SetTimeCodesPerSecond(float(rig.rate))
        stage.SetFramesPerSecond(float(rig.rate))
    skin, extent = rigging.skin(rigging.influences), root.CreateExtentAttr()
    for frame, code in enumerate(rig.codes):
        points = deform(mesh.positions, skin, rig.matrices(frame))
        box = Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)]).astype(np.float32))
        extent.Set(box, Usd.TimeCode.Default() if still else Usd.TimeCode(float(code)))


def _paths(skeleton: Skeleton) -> list[str]:
    """Joints as paths of valid names, no two alike."""
    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents, strict=True):
        own = Tf.MakeValidIdentifier(name.split("/")[-1] or "joint")
        stem, n = (f"{paths[parent]}/" if parent >= 0 else "") + own, 1
        path = stem
        while path in paths:
            n += 1
            path = f"{stem}_{n}"
        paths.append(path)
    return paths


def _matrices(matrices: np.ndarray) -> Vt.Matrix4dArray:
    """Matrices (J, 4, 4) for column vectors as USD's for row vectors."""
    return Vt.Matrix4dArray([Gf.Matrix4d(*map(float, m.T.ravel())) for m in matrices])
