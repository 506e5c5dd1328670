"""
STEP files through OpenCASCADE (package cascadio), which makes triangles of their surfaces.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

from ...errors import AssetError
from ...model.asset import Asset
from ..gltf.read import read_gltf
from ..resources import read_bytes

#: How far triangles may be from the surface, as a share of the edges [1], and by how much they may turn [radians]. The
#: triangles are what is simplified, so there may be many.
_LINEAR, _ANGULAR = 1e-3, 0.2


def read_step(path: Path) -> Asset:
    """
    Read a STEP file: its solids as parts with their colours and placements, in metres.

    Raises
    ------
    AssetError
        It cannot be read, or the package is missing.
    """
    try:
        import cascadio
    except ImportError as error:
        raise AssetError(
            f"{path.name}: STEP needs the package cascadio: pip install 'mi-simplify[formats]', or export the file as "
            "GLB"
        ) from error
    read_bytes(path, "STEP file")  # for the messages of what cannot be read
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "converted.glb"
        code = cascadio.step_to_glb(
            os.fspath(path), os.fspath(glb), tol_linear=_LINEAR, tol_angular=_ANGULAR, tol_relative=True
        )
        if code or not glb.exists():
            raise AssetError(f"{path.name}: OpenCASCADE cannot read it; export it again, or as GLB")
        asset = read_gltf(glb)
    notes = [f"STEP surfaces are split into {asset.n_triangles:,} triangles, lengths are metres"]
    return replace(asset, notes=(*notes, *asset.notes), tree=None)
