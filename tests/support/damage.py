"""What goes wrong when another program reduces a mesh (Hasselgren et al. 2021, Fig. 6), done on purpose."""

from dataclasses import replace

import numpy as np

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.model import Model
from mi_simplify.model.topology import vertex_normals


def damaged(model: Model, seed: int = 0, *, pieces: int = 4, spikes: float = 0.03) -> Model:
    """
    A model with lost volume, self-intersections, detached pieces and wrong textures; its faces and UVs stay.

    Parameters
    ----------
    model : Model
        Any unit; lengths below are shares of its box's longest side.
    pieces : int
        Patches that are cut off and moved.
    spikes : float
        Share of the positions that are pushed through the surface.
    """
    rng = np.random.default_rng(seed)
    mesh = model.mesh
    size = float(np.ptp(mesh.positions, axis=0).max())
    p = mesh.positions - 0.015 * size * vertex_normals(mesh.positions, mesh.position_faces)  # thinner everywhere
    pushed = rng.random(len(p)) < spikes
    p[pushed] += 0.06 * size * _directions(rng, int(pushed.sum()))
    mesh = _detached(replace(mesh, positions=p), rng, pieces, size)
    return replace(
        model, mesh=mesh,
        base_color=np.roll(model.base_color, model.base_color.shape[0] // 3, axis=(0, 1)),
        specular=np.roll(model.specular, model.specular.shape[0] // 3, axis=(0, 1)),
        normal=np.roll(model.normal, model.normal.shape[0] // 3, axis=(0, 1)),
    )  # fmt: skip


def _detached(mesh: Mesh, rng: np.random.Generator, pieces: int, size: float) -> Mesh:
    """Faces around random places, a tenth of the size across, with positions of their own, somewhere near."""
    centres = mesh.positions[mesh.position_faces].mean(1)
    for _ in range(pieces):
        seed = centres[rng.integers(len(centres))]
        piece = np.linalg.norm(centres - seed, axis=1) < 0.1 * size
        inside = np.unique(mesh.faces[piece])
        own, index = np.unique(mesh.position_index[inside], return_inverse=True)
        twin = np.arange(len(mesh.uvs))
        twin[inside] = len(mesh.uvs) + np.arange(len(inside))
        shift = rng.uniform(0.03, 0.06) * size * _directions(rng, 1)
        mesh = Mesh(
            np.concatenate([mesh.positions, mesh.positions[own] + shift]),
            np.concatenate([mesh.position_index, len(mesh.positions) + index]),
            np.concatenate([mesh.uvs, mesh.uvs[inside]]),
            np.where(piece[:, None], twin[mesh.faces], mesh.faces),
        )
    return mesh


def _directions(rng: np.random.Generator, n: int) -> np.ndarray:
    """Unit vectors, shape (n, 3)."""
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)
