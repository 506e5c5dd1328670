"""
A character in a file that is written: joints, weights, skin, animation.
"""

from __future__ import annotations

import numpy as np

from ...model.mesh import Mesh
from ...model.rigging import Rigging
from ...model.skeleton import influences, skeleton_of
from .container import ARRAY_BUFFER, Container, some
from .quantize import Grid, shares


def write_rig(
    container: Container, name: str, rigging: Rigging, mesh: Mesh, grid: Grid | None, node: dict, attributes: dict
) -> dict:
    """
    Append a character's rig; its weights join the attributes.

    Parameters
    ----------
    mesh : Mesh
        As stored.
    grid : Grid or None
        What positions are rounded to; nodes of skinned meshes do not move them, so that the joints undo it.
    node : dict
        Of the mesh; it becomes node 0.
    attributes : dict
        Of the primitive.

    Returns
    -------
    dict
        More of the document: joints as nodes after the mesh's, skin and animation.
    """
    skeleton = skeleton_of(rigging.rig)
    joints, weights = influences(rigging)
    joints, weights = joints[mesh.position_index], weights[mesh.position_index]
    stored = weights.astype("<f4") if grid is None else shares(weights)
    kind = "u1" if len(skeleton.names) <= 256 else "<u2"
    for k in range(joints.shape[1] // 4):
        four = slice(4 * k, 4 * k + 4)
        which = np.where(stored[:, four] > 0, joints[:, four], 0).astype(kind)
        attributes[f"JOINTS_{k}"] = container.accessor(which, ARRAY_BUFFER)
        attributes[f"WEIGHTS_{k}"] = container.accessor(stored[:, four], ARRAY_BUFFER, normalized=grid is not None)
    first = 2  # nodes 0 and 1 are the mesh and what holds all joints
    children: list[list[int]] = [[] for _ in range(len(skeleton.names) + 1)]
    for j, parent in enumerate(skeleton.parents):
        children[parent].append(first + j)  # of -1: the last list
    curves = {"translation": skeleton.translations, "rotation": skeleton.rotations, "scale": skeleton.scales}
    nodes = [node | {"skin": 0}, {"name": "skeleton", "children": children[-1]}]
    for j, joint in enumerate(skeleton.names):
        own = {key: curve[0, j].tolist() for key, curve in curves.items()}
        nodes.append({"name": joint, **own, **some("children", children[j] or None)})
    inverse = np.linalg.inv(skeleton.bind)
    if grid is not None:
        inverse = inverse @ grid.to_mesh
    inverse = inverse.swapaxes(1, 2).reshape(-1, 16)
    inverse[:, 3::4] = [0.0, 0.0, 0.0, 1.0]
    skin = {
        "name": name, "skeleton": 1, "joints": [first + j for j in range(len(skeleton.names))],
        "inverseBindMatrices": container.accessor(inverse.astype("<f4")),
    }  # fmt: skip
    more = {"nodes": nodes, "skins": [skin], "scenes": [{"nodes": [0, 1]}]}
    rig, animations = rigging.rig, []
    for clip, start, stop in rig.clips or (("clip", 0, rig.n_frames),):
        if stop > start:
            own = {path: curve[start:stop] for path, curve in curves.items()}
            animations.append(_animation(container, clip, rig.times[start:stop] - rig.times[start], own, first))
    return more | some("animations", [animation for animation in animations if animation] or None)


def _animation(
    container: Container, clip: str, times: np.ndarray, curves: dict[str, np.ndarray], first: int
) -> dict | None:
    """Channels of all that moves; None where nothing does."""
    samplers: list[dict] = []
    channels: list[dict] = []
    time = None
    for path, curve in curves.items():
        for j in np.flatnonzero(np.ptp(curve, axis=0).max(1) > 1e-7):
            if time is None:
                time = container.accessor(times.astype("<f4"), bounds=True)
            channels.append({"sampler": len(samplers), "target": {"node": int(first + j), "path": path}})
            output = container.accessor(np.asarray(curve[:, j], "<f4"))
            samplers.append({"input": time, "output": output, "interpolation": "LINEAR"})
    return {"name": clip, "samplers": samplers, "channels": channels} if channels else None
