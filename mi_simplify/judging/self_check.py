"""
Whether a written file shows what was fitted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from ..formats.gltf.file import GltfFile
from ..formats.images import join_channels
from ..integrators.deferred import DeferredRenderer
from ..latent.latent import Latent
from ..latent.surface import MeshTopology, Surface
from ..latent.textures import Textures, needs_extended
from ..machine.upload import upload
from ..model.asset import Asset, Part
from ..model.frame import Frame
from ..model.mesh import Mesh
from ..model.model import Model
from ..model.nodes.placing import expanded
from ..model.rig import BIND_POSE, turn
from ..model.tangents import vertex_tangents
from ..scenes.shapes import part_normals
from ..scenes.views import Views, held_out_views
from .metrics import psnr

LEAST_PSNR = 45.0
"""What a file reaches that lost nothing but the precision of 8-bit textures [dB]."""

LEAST_LOSSY_PSNR = 24.0
"""What a file reaches whose textures were made smaller on request, and that is still one of the model [dB]."""


def self_check(model: Model, written: Asset, *, form: str = "gltf", n_views: int = 4, resolution: int = 256) -> float:
    """
    How alike the latent model and a file of it are, lit directly.

    Both are rendered by the renderer of the fit from the same sample positions, so that the difference is the file's.
    Of the file nothing but its vertices, normals, tangents, texture coordinates and images is used, and its skeleton; a
    character is compared in two frames of its clip, with the weights that its file keeps.

    Parameters
    ----------
    model : Model
        What was fitted.
    written : Asset
        What was read back in the frame of the model: parts that share one atlas.
    form : {'gltf', 'paper'}
        Mixing of the lobes.
    n_views, resolution : int
        How many square images of how many pixels.

    Returns
    -------
    float
        PSNR of what a screen shows, mean over the views [dB]; 100 where nothing differs.
    """
    model = expanded(model)
    frame = Frame.around(written.bounds)  # any units, and coordinates far from the origin
    model, written = model.transformed(frame.scale, -frame.scale * frame.center), frame.normalised(written)
    if model.skin is not None:
        # Of a single frame the weights are what they are; where they are fitted none begins at 0, which shows.
        model = replace(model, skin=replace(model.skin.pruned(), fitted=model.skin.fitted[:1]))
    found = []
    for time in _frames(written):
        shown = written.posed(time)
        views = held_out_views(shown.bounds, n_views, resolution).at(time)
        tangents = _posed_tangents(written, shown, time)
        there = _render(*as_written(shown.placed(), tangents), views, form)
        found.append(psnr(latent_images(model, views, form), there).mean())
    return float(np.mean(found))


def latent_images(model: Model, views: Views, form: str = "gltf") -> np.ndarray:
    """
    A model as the fit shows it, lit directly, from views of one frame, shape (B, H, W, 4).
    """
    latent = Latent(model, needs_extended(model.base_color, model.specular))
    operation = latent.operation
    base = upload(mi.Float, operation.base.positions.ravel())
    parameters = {name: upload(mi.Float, value) for name, value in operation.parameters.items()}
    positions = operation.positions(base, parameters, views)
    surface = latent.evaluate(positions, base, parameters, views)
    return _render(latent.topology, surface, latent.textures, positions, views, form)


def _frames(written: Asset) -> list[int]:
    """Frames to compare in: two of a clip, else how the file stands, which is in the bind pose without a rig."""
    return [BIND_POSE] if written.rig is None else sorted({written.rig.n_frames // 4, 3 * written.rig.n_frames // 4})


def _posed_tangents(written: Asset, shown: Asset, time: int) -> list[np.ndarray] | None:
    """Stored tangents of what a frame shows, shape (V, 4) for each instance; None where there are none."""
    stored = stored_tangents(written)
    if stored is None:
        return None
    out = []
    for before, after in zip(written.instances, shown.instances, strict=True):
        tangents, skin = stored[before.part], written.parts[before.part].skin
        if skin is not None and written.rig is not None:
            turned, sign = turn(tangents[:, :3], skin, written.rig.matrices(time)[:, :3, :3]), 1.0
        else:
            linear = after.to_world[:3, :3]
            turned, sign = tangents[:, :3] @ linear.T, np.sign(np.linalg.det(linear))
            turned = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
        out.append(np.concatenate([turned, sign * tangents[:, 3:]], axis=1))
    return out


def stored_tangents(written: Asset) -> list[np.ndarray] | None:
    """
    Tangents and handedness that a GLB file of ours carries, shape (V, 4) for each part; None where it has none, as
    other formats.
    """
    if not written.source.endswith(".glb"):
        return None
    file = GltfFile(Path(written.source), [])
    primitives = [primitive for mesh in file.json["meshes"] for primitive in mesh["primitives"]]
    stored = [primitive["attributes"].get("TANGENT") for primitive in primitives]
    if None in stored:
        return None
    # Primitives share their vertices; a part has those of its faces, in their order.
    return [file.accessor(s)[np.unique(file.accessor(p["indices"]))] for s, p in zip(stored, primitives, strict=True)]


def _joined(parts: list[Part]) -> Part:
    """Parts that share an atlas as one: in it the texels of opaque ones are opaque."""
    modes = {part.material.alpha_mode for part in parts}
    mode = next(mode for mode in ("BLEND", "MASK", "OPAQUE") if mode in modes)
    start = np.cumsum([0] + [len(part.vertices) for part in parts])
    return replace(
        parts[0],
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + n for part, n in zip(parts, start, strict=False)]),
        normals=np.concatenate([part_normals(part) for part in parts]).astype(np.float32),
        uvs=np.concatenate([np.zeros((0, 2)) if part.uvs is None else part.uvs for part in parts]),
        material=replace(parts[0].material, alpha_mode=mode),
    )


def as_written(
    parts: list[Part], tangents: list[np.ndarray] | None
) -> tuple[MeshTopology, Surface, Textures, mi.Float]:
    """
    Parts that share an atlas on the device, with normals and tangents as in their file; MikkTSpace's tangents where it
    has none.
    """
    part = parts[0] if len(parts) == 1 else _joined(parts)
    vertex = np.arange(len(part.vertices))
    assert part.uvs is not None  # every exporter writes them
    topology = MeshTopology(Mesh(part.vertices, vertex, part.uvs, part.faces))
    mesh, normals = topology.mesh, part_normals(part)
    if tangents is None:
        t, w = vertex_tangents(mesh, normals)
    else:
        every = np.concatenate(tangents)[mesh.position_index]
        t, w = every[:, :3], every[:, 3]
    u, v = mesh.uvs[:, :1], mesh.uvs[:, 1:]
    packets = np.concatenate([mesh.vertices, u, normals[mesh.position_index], v, t, w[:, None]], axis=1)
    material = part.material
    normal = np.array([[[0, 0, 1]]], np.float32) if material.normal is None else material.normal
    joined = join_channels(material.base_color, material.specular, normal)
    color, specular, normal = joined[..., :4], joined[..., 4:7], joined[..., 7:]
    if material.alpha_mode == "OPAQUE":
        color = np.concatenate([color[..., :3], np.ones_like(color[..., 3:])], axis=2)
    textures = Textures(color, specular, normal, needs_extended(color, specular))
    surface = Surface(upload(mi.Float, packets.ravel()), topology.faces)
    return topology, surface, textures, upload(mi.Float, mesh.positions.ravel())


def _render(
    topology: MeshTopology, surface: Surface, textures: Textures, positions: mi.Float, views: Views, form: str
) -> np.ndarray:
    """Images of the views, shape (B, H, W, 4)."""
    renderer = DeferredRenderer(topology, form=form)
    renderer.move(positions)
    with dr.suspend_grad():
        frame = renderer.render(surface, textures, views, spp=4, seed=dr.opaque(mi.UInt32, 1))
    return frame.images()
