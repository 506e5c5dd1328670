"""
Mitsuba meshes from arrays and back: the one module that knows the names of Mitsuba's mesh parameters.

Mitsuba 3.10 renames all of them (``vertex_positions`` becomes ``positions``, and so on); nothing else in the project
spells them out.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

#: Face index of a ray that hit nothing.
MISS = 0xFFFFFFFF

POSITIONS, FACES, NORMALS, UVS = "vertex_positions", "faces", "vertex_normals", "vertex_texcoords"
TANGENTS = "vertex_tangent"


def make_mesh(
    name, vertices, faces, normals=None, uvs=None, bsdf=None, tangents=None, colors=None, more_uvs=()
) -> mi.Mesh:
    """
    A Mitsuba mesh from arrays.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
    faces : ndarray, shape (F, 3)
    normals, tangents : ndarray, shape (V, 3), optional
        Tangents become the mesh attribute ``vertex_tangent``.
    uvs : ndarray, shape (V, 2), optional
        Origin top left, as Mitsuba's bitmaps have it.
    bsdf : mi.BSDF, optional
    colors : ndarray, shape (V, 4), optional
        Linear colour and opacity, which become the mesh attributes ``vertex_color`` and ``vertex_opacity``.
    more_uvs : sequence of ndarray, shape (V, 2)
        Further texture coordinates, which become the mesh attributes ``vertex_uv1``, ``vertex_uv2``, …
    """
    props = mi.Properties()
    if bsdf is not None:
        props["bsdf"] = bsdf
    mesh = mi.Mesh(
        name, len(vertices), len(faces), props=props,
        has_vertex_normals=normals is not None, has_vertex_texcoords=uvs is not None,
    )  # fmt: skip
    if tangents is not None:
        mesh.add_attribute(TANGENTS, 3, np.ascontiguousarray(tangents, np.float32).ravel())
    if colors is not None:
        mesh.add_attribute("vertex_color", 3, np.ascontiguousarray(colors[:, :3], np.float32).ravel())
        mesh.add_attribute("vertex_opacity", 1, np.ascontiguousarray(colors[:, 3], np.float32))
    for k, more in enumerate(more_uvs):
        mesh.add_attribute(f"vertex_uv{k + 1}", 3, np.pad(np.float32(more), ((0, 0), (0, 1))).ravel())
    params = mi.traverse(mesh)
    params[POSITIONS] = np.ascontiguousarray(vertices, np.float32).ravel()
    params[FACES] = np.ascontiguousarray(faces, np.uint32).ravel()
    if normals is not None:
        params[NORMALS] = np.ascontiguousarray(normals, np.float32).ravel()
    if uvs is not None:
        params[UVS] = np.ascontiguousarray(uvs, np.float32).ravel()
    params.update()
    return mesh


def mesh_keys(
    name: str, vertices: np.ndarray, normals: np.ndarray, tangents: np.ndarray | None
) -> dict[str, np.ndarray]:
    """
    Parameters of a scene with a mesh of this name, by key, that move its vertices.
    """
    values = {POSITIONS: vertices, NORMALS: normals}
    if tangents is not None:
        values[TANGENTS] = tangents
    return {f"{name}.{key}": np.ascontiguousarray(value, np.float32).ravel() for key, value in values.items()}


def mesh_positions(mesh: mi.Mesh) -> mi.Float:
    """
    Vertex positions of a mesh as it is rendered, flat ``x0 y0 z0 x1 …``; carries the gradient that is on them.
    """
    return mi.traverse(mesh)[POSITIONS]


def mesh_faces(mesh: mi.Mesh) -> np.ndarray:
    """
    Vertex indices, shape (F, 3).
    """
    return mi.traverse(mesh)[FACES].numpy().reshape(-1, 3).astype(np.int64)


def mesh_normals(mesh: mi.Mesh) -> np.ndarray | None:
    """
    Vertex normals, shape (V, 3), or None for a faceted mesh.
    """
    if not mesh.has_vertex_normals():
        return None
    return mi.traverse(mesh)[NORMALS].numpy().reshape(-1, 3)


def mesh_uvs(mesh: mi.Mesh) -> np.ndarray | None:
    """
    Texture coordinates, shape (V, 2), or None.
    """
    if not mesh.has_vertex_texcoords():
        return None
    return mi.traverse(mesh)[UVS].numpy().reshape(-1, 2)


class MovingMesh:
    """
    A mesh whose positions change from step to step, alone in a scene of its own that rays are traced against.

    The scene only finds hits; positions, normals and textures are looked up outside of it.
    """

    def __init__(self, positions: np.ndarray, faces: np.ndarray):
        # Mitsuba has Embree try a spatial split wherever boxes overlap by more than 5e-6 of the scene's area, which
        # takes three quarters of a build and gains nothing here. A point far away makes the scene so large that it
        # never does.
        far = make_mesh("far", np.full((3, 3), _FAR * max(1.0, np.abs(positions).max())), np.array([[0, 1, 2]]))
        self.scene = mi.load_dict({"type": "scene", "mesh": make_mesh("moving", positions, faces), "far": far})
        self._params = mi.traverse(self.scene)
        self._key = f"mesh.{POSITIONS}"
        self._params.keep([self._key])

    def move(self, positions: mi.Float) -> None:
        """
        Set the positions, flat ``x0 y0 z0 …``, and rebuild the acceleration structure.
        """
        self._params[self._key] = dr.detach(positions)
        self._params.update()


#: Of the point outside, in sizes of the mesh.
_FAR = 1e4
