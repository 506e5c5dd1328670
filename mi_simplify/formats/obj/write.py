"""
Wavefront OBJ out: mesh, material library, and PNG textures beside it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ... import __version__
from ...errors import MeshError
from ...machine.files import side_file_stem, write_atomic
from ...model.groups import Groups
from ...model.model import Model
from ..origin import recentred
from ..textures import HOLDS_AMBIENT, Textures, encode_textures, png


def write_obj(model: Model, path: str | Path) -> Path:
    """
    Write a model as OBJ + MTL + PNG; v is flipped, as OBJ's uv origin is bottom left.

    Positions stay welded (``v/vt/vn`` indices). The library uses the PBR keywords ``norm``,
    ``map_Pr`` and ``map_Pm`` beside ``map_Kd``; opacity leaves as ``map_d`` (cut to 0 or 1 under
    MASK), emission as ``map_Ke``. Gamma of dielectrics and occlusion have no keyword and are lost. A model far from the
    origin is stored around it, and a comment in the head says where its origin stands, for :func:`.read.read_obj`.

    Parameters
    ----------
    model : Model
    path : str or Path
        The ``.obj``, in an existing folder; the other files are named after it.

    Returns
    -------
    Path

    Raises
    ------
    MeshError
        The mesh has no faces.
    OutputError
        A file cannot be written.
    """
    path = Path(path)
    if not len(model.mesh.faces):
        raise MeshError("nothing to export: the mesh has no faces")
    model, origin = recentred(model)
    stem = side_file_stem(path)
    textures = encode_textures(model)
    images = _images(model, textures)
    for key, image in images.items():
        write_atomic(path.with_name(f"{stem}_{key}.png"), png(image))
    ambient = model.ambient if textures.holds_ambient else None
    names = material_names(model, stem)
    library = _library(stem, names, model.face_groups, images, textures.emission_strength, ambient)
    write_atomic(path.with_name(f"{stem}.mtl"), library)
    return write_atomic(path, _mesh(model, stem, names, origin))  # last: what names the others


def material_names(model: Model, stem: str) -> list[str]:
    """
    Of the groups, distinct and without blanks: the file's own where there is but one.
    """
    kinds = model.face_groups.kinds
    if len(kinds) == 1:
        return [stem]
    return [f"{k}_{re.sub(r'[^A-Za-z0-9_]+', '_', kind.name)}" for k, kind in enumerate(kinds)]


def _images(model: Model, textures: Textures) -> dict[str, np.ndarray]:
    """8-bit images by the ending of their file's name."""
    images = {
        "base_color": textures.base_color,
        "normal": textures.normal,
        "roughness": textures.orm[..., 1],
        "metallic": textures.orm[..., 2],
    }
    if textures.emission is not None:
        images["emission"] = textures.emission
    opacity, masks = textures.base_color[..., 3], [k for k in model.face_groups.kinds if k.alpha_mode == "MASK"]
    if model.alpha_mode == "BLEND":
        images["opacity"] = opacity
    elif model.alpha_mode == "MASK":
        images["opacity"] = np.where(opacity >= masks[0].alpha_cutoff * 255.0, 255, 0).astype(np.uint8)
    return images


def _library(
    stem: str, names: list[str], groups: Groups, images: dict[str, np.ndarray], emission: float,
    ambient: np.ndarray | None,
) -> str:  # fmt: skip
    """The material library; factors are 1 so that readers which multiply and readers which replace agree."""
    keywords = {"base_color": "map_Kd", "normal": "norm", "roughness": "map_Pr", "metallic": "map_Pm"}
    keywords |= {"opacity": "map_d", "emission": "map_Ke"}
    lines = [f"# mi_simplify {__version__}"]
    if ambient is not None:
        lines.append(f"# {HOLDS_AMBIENT}: " + " ".join(f"{x:.6g}" for x in ambient.ravel()))
    for name, kind in zip(names, groups.kinds, strict=True):
        lines += [f"newmtl {name}", "Kd 1 1 1", "Pr 1", "Pm 1", "illum 2"]
        if "emission" in images:
            lines.append(f"Ke {emission:.6g} {emission:.6g} {emission:.6g}")
        shown = [key for key in images if key != "opacity" or kind.alpha_mode != "OPAQUE"]
        lines += [f"{keywords[key]} {stem}_{key}.png" for key in shown]
    return "\n".join(lines) + "\n"


def _mesh(model: Model, stem: str, names: list[str], origin: np.ndarray) -> str:
    """The mesh as text; nine digits carry a float32 exactly."""
    mesh = model.mesh
    normals = mesh.normals()
    uvs = np.asarray(mesh.uvs, np.float64) * [1.0, -1.0] + [0.0, 1.0]
    p, t, n = mesh.position_faces + 1, mesh.faces + 1, mesh.normal_groups[mesh.faces] + 1
    corners = np.stack([p, t, n], axis=2).reshape(-1, 9)  # (F, 9): v/vt/vn three times
    runs = [corners[model.face_groups.of_face == k] for k in range(len(names))]
    faces = (f"usemtl {x}\n" + _lines("f %d/%d/%d %d/%d/%d %d/%d/%d\n", f) for x, f in zip(names, runs, strict=True))
    return "".join(
        [
            f"# mi_simplify {__version__}\n",
            "# origin: {:.17g} {:.17g} {:.17g}\n".format(*origin) if origin.any() else "",
            f"mtllib {stem}.mtl\no {stem}\n",
            _lines("v %.9g %.9g %.9g\n", mesh.positions),
            _lines("vt %.9g %.9g\n", uvs),
            _lines("vn %.7g %.7g %.7g\n", normals),
            *faces,
        ]
    )


def _lines(pattern: str, rows: np.ndarray) -> str:
    """One line of text per row, formatted in one go."""
    return pattern * len(rows) % tuple(rows.ravel().tolist())
