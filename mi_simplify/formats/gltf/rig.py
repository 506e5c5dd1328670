"""
What moves in a file that is written: the joints, weights and skin of a character, or nodes with meshes; animation.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...model.mesh import Mesh
from ...model.model import Model
from ...model.nodes.placing import moved, submodels
from ...model.rig import Rig
from ...model.rigging import Rigging
from ...model.skeleton import decomposed, influences, skeleton_of
from ...model.tree import Tree
from .container import ARRAY_BUFFER, Container, some
from .quantize import Grid, shares

log = logging.getLogger("mi_simplify")


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
    rest = {path: curve[:1] for path, curve in curves.items()}
    return more | _animations(container, rigging.rig, curves, rest, list(range(first, first + len(skeleton.names))))


def write_nodes(container: Container, model: Model, write: Callable[[Model], tuple[dict, dict]]) -> dict:
    """
    Append the meshes of the nodes that a model keeps, and how these are animated.

    Nodes stand in the order of the tree, parents before children; a mesh that needs a transform of its own, and what
    belongs to no node, have nodes besides. A node that shears has a matrix, or is written without shear where it is
    animated, with a warning.

    Parameters
    ----------
    write : callable
        ``write(part)`` appends a model in one piece and returns its mesh, and the transform that its node needs.

    Returns
    -------
    dict
        ``scenes``, ``nodes``, ``meshes`` and ``animations`` of the document.
    """
    nodes = model.nodes
    assert nodes is not None
    tree = nodes.tree
    meshes: list[dict] = []
    of_node: dict[int, tuple[int, dict]] = {}
    for part, placed in zip(submodels(model), nodes.placed, strict=True):
        if part is None:
            continue
        name = (tree.names[placed[0]] if placed[0] >= 0 else "") or model.name
        mesh, place = write(replace(moved(part, np.linalg.inv(nodes.world(placed[0]))), name=name))
        of_node |= {node: (len(meshes), place) for node in placed}
        meshes.append(mesh)
    named = zip(tree.names, _local(tree), strict=True)
    out = [{**some("name", name or None), **_transform(matrix)} for name, matrix in named]
    roots: list[int] = []
    for k, parent in enumerate(tree.parents.tolist()):
        (roots if parent < 0 else out[parent].setdefault("children", [])).append(k)
    for node, (k, place) in of_node.items():
        if node >= 0 and not place:
            out[node]["mesh"] = k
            continue
        (roots if node < 0 else out[node].setdefault("children", [])).insert(0, len(out))
        out.append({"name": meshes[k]["name"], "mesh": k, **place})
    scene = {"scenes": [{"nodes": roots}], "nodes": out, "meshes": meshes}
    if model.skin is None or not len(tree.moving):
        return scene
    curves, sheared = decomposed(tree.motion)
    if sheared.any():
        names = ", ".join(np.array(tree.names)[tree.moving][sheared][:3])
        log.warning("nodes shear in the animation, which no file can hold; written without shear: %s", names)
    rest, _ = decomposed(tree.local[None, tree.moving])
    for j, k in enumerate(tree.moving.tolist()):  # glTF forbids matrices of what is animated
        out[k].pop("matrix", None)
        out[k] |= {path: curve[0, j].tolist() for path, curve in rest.items()}
    return scene | _animations(container, model.skin.rig, curves, rest, tree.moving.tolist())


def _local(tree: Tree) -> np.ndarray:
    """Transforms of the nodes in a file whose space is that of the model, shape (N, 4, 4)."""
    local = tree.local.copy()
    if np.abs(tree.frame - np.eye(4)).max() > _SAME:
        local[tree.parents < 0] = tree.frame @ local[tree.parents < 0]
    return local


def _transform(matrix: np.ndarray) -> dict:
    """A node's transform: what differs from none of translation, rotation and scale; a matrix if it shears."""
    curves, sheared = decomposed(matrix[None, None])
    if sheared.any() or abs(np.linalg.det(matrix[:3, :3])) < _FLAT:
        return {"matrix": matrix.T.ravel().tolist()}
    plain = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
    found = {path: curve[0, 0].tolist() for path, curve in curves.items()}
    found["translation"] = matrix[:3, 3].tolist()
    return {path: value for path, value in found.items() if np.abs(np.subtract(value, plain[path])).max() > _NONE}


#: How far the frame of a model may be from that of its file for rounding [units of the file].
_SAME = 1e-9

#: A determinant below this is 0; parts of a transform below this are none.
_FLAT, _NONE = 1e-30, 1e-7


def _animations(
    container: Container, rig: Rig, curves: dict[str, np.ndarray], rest: dict[str, np.ndarray], nodes: list[int]
) -> dict:
    """All clips of a rig, for these nodes of the document, which at rest stand as ``rest`` has it."""
    animations = []
    for clip, start, stop in rig.clips or (("clip", 0, rig.n_frames),):
        if stop > start:
            own = {path: curve[start:stop] for path, curve in curves.items()}
            times = rig.times[start:stop] - rig.times[start]
            animations.append(_animation(container, clip, times, own, rest, nodes))
    return some("animations", [animation for animation in animations if animation] or None)


def _animation(
    container: Container,
    clip: str,
    times: np.ndarray,
    curves: dict[str, np.ndarray],
    rest: dict[str, np.ndarray],
    nodes: list[int],
) -> dict | None:
    """Channels of all that moves, or stands elsewhere than at rest; None where nothing does."""
    samplers: list[dict] = []
    channels: list[dict] = []
    time = None
    for path, curve in curves.items():
        for j in np.flatnonzero(np.abs(curve - rest[path]).max((0, 2)) > _NONE):
            if time is None:
                time = container.accessor(times.astype("<f4"), bounds=True)
            channels.append({"sampler": len(samplers), "target": {"node": nodes[j], "path": path}})
            output = container.accessor(np.asarray(curve[:, j], "<f4"))
            samplers.append({"input": time, "output": output, "interpolation": "LINEAR"})
    return {"name": clip, "samplers": samplers, "channels": channels} if channels else None
