"""
A morphable face out of a file: its mesh, its morph targets, and which of its vertices are landmarks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...config.commands.face import FaceSettings
from ...errors import AssetError, ConfigError
from ...formats.load import load_asset
from ...latent.file_model import file_model
from ...latent.morphing import MorphedModel
from ...model.mesh import Mesh
from ...model.model import Morphs
from ...transfer.archive import opened

_EXPECTED = "a morphable face (npz with neutral, quads, uvs, uv_quads, identity, expression, landmarks)"

#: Roughness of skin, where the fit begins.
_ROUGHNESS = 0.5


def open_morphable(settings: FaceSettings) -> tuple[MorphedModel, np.ndarray, int]:
    """
    The model that the settings name, in the units of its file, all weights 0.

    Returns
    -------
    model : MorphedModel
        With flat textures; an npz whose texture coordinates go beyond 1 has several images side by side in one.
    landmarks : ndarray, shape (L,)
        Positions of its mesh.
    n_identity : int
        How many of its morph targets, the first ones, are who it is and not what it expresses.

    Raises
    ------
    AssetError
        The file is missing or damaged, or a morph target has another size than its mesh.
    ConfigError
        A glTF file without ``landmarks``.
    """
    if Path(settings.model).suffix.lower() == ".npz":
        return _of_arrays(settings)
    asset = load_asset(settings.model)
    quantities = ["weights", "base_color", "normal", "roughness", "metallic"]
    model = file_model(asset, quantities, settings.texture_size).model
    if not isinstance(model, MorphedModel) or model.morphs is None:
        raise AssetError(f"{asset.name}: it has no morph targets; a face that can be fitted has some")
    if not settings.landmarks:
        raise ConfigError(f"landmarks: where those of {asset.name} are is not known; give as many points [x, y, z]")
    model = model.moved_to(np.zeros(len(model.morphs.names)))
    return model, cKDTree(model.mesh.positions).query(np.array(settings.landmarks))[1], 0


def _of_arrays(settings: FaceSettings) -> tuple[MorphedModel, np.ndarray, int]:
    path = Path(settings.model)
    with opened(path, _EXPECTED, "take another file") as data:
        neutral, quads, uvs, uv_quads, marks = (
            np.array(data[name]) for name in ("neutral", "quads", "uvs", "uv_quads", "landmarks")
        )
        identity, expression = np.array(data["identity"]), np.array(data["expression"])
        named = [str(name) for name in data["expression_names"]]
    for name, offsets in (("identity", identity), ("expression", expression)):
        if offsets.ndim != 3 or offsets.shape[1:] != neutral.shape or not np.isfinite(offsets).all():
            raise AssetError(
                f"{path.name}: morph targets '{name}' are of shape {offsets.shape}, its mesh of {neutral.shape}; every "
                "target needs an offset for every vertex"
            )
    fit = len(named) == len(expression) and quads.shape == uv_quads.shape
    in_range = (
        fit and 0 <= quads.min() and quads.max() < len(neutral) and 0 <= uv_quads.min() and uv_quads.max() < len(uvs)
        and 0 <= marks.min() and marks.max() < len(neutral)
    )  # fmt: skip
    if not in_range:
        raise AssetError(f"{path.name}: quads, landmarks or names do not fit its {len(neutral)} vertices")
    pairs, corner = np.unique(np.stack([quads.ravel(), uv_quads.ravel()], 1), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 4)
    # Texture coordinates count images from left to right (UDIM), with the origin at the bottom.
    tiles = max(1, int(np.ceil(uvs[:, 0].max())))
    at = np.stack([uvs[pairs[:, 1], 0] / tiles, 1 - uvs[pairs[:, 1], 1]], 1).astype(np.float32)
    mesh = Mesh(
        positions=neutral.astype(np.float64),
        position_index=pairs[:, 0].astype(np.int64),
        uvs=at,
        faces=np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]]).astype(np.int64),
    )
    kept = identity[: settings.identity]
    names = (*(f"identity {k}" for k in range(len(kept))), *named)
    offsets = np.concatenate([kept, expression]).astype(np.float64)
    size = settings.texture_size, settings.texture_size * tiles
    model = MorphedModel(
        mesh=mesh,
        base_color=_flat(size, 0.5, 0.5, 0.5, 1),
        specular=_flat(size, 0, _ROUGHNESS, 0),
        normal=_flat(size, 0, 0, 1),
        name=path.stem,
        morphs=Morphs(names, (0.0,) * len(names), offsets),
    )
    return model, marks.astype(np.int64), len(kept)


def _flat(size: tuple[int, int], *values: float) -> np.ndarray:
    """An image of this height and width that is the same everywhere."""
    return np.tile(np.array(values, np.float32), (*size, 1))
