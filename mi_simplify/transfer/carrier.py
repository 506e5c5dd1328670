"""
Transfer beside a simplified model: checked before the fit, written and measured after it.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np

from ..config.export import CarriedSettings
from ..errors import ConfigError
from ..formats.mitsuba.read import SceneAsset
from ..judging.metrics import tonemap
from ..machine.files import write_atomic
from ..model.asset import Asset
from ..progress import ProgressCallback, silent
from ..report.folder import PLAYER
from ..report.viewer import MOST_TRIANGLES
from .body import Body, Places
from .carried import CarriedTransfer, carried, is_lit, lookup, nearest
from .cast import Caster, unshadowed
from .light import SKIES, shade, sky
from .picture import Camera, Hits, seen
from .player import VIEW, Surface, player_data

log = logging.getLogger("mi_simplify")

FILE = "transfer.npz"

#: Of the surfaces in pictures, so that nothing in them is clipped.
GREY = 0.8

#: Pictures that are compared, and their side [px].
N_PICTURES, SIZE = 6, 128

#: Frames that a report plays, at most, and how many coefficients of the original it carries for them.
SHOWN, MOST_COEFFICIENTS = 8, 6_000_000


class Carrier:
    """
    Makes the transfer textures of a small model.

    Parameters
    ----------
    original : Asset or None
        What rays are cast on.
    settings : CarriedSettings

    Raises
    ------
    ConfigError
        There is no mesh to cast rays on.
    """

    def __init__(self, original: Asset | None, settings: CarriedSettings):
        if original is None or isinstance(original, SceneAsset):
            raise ConfigError("export.transfer: a model file with triangles to cast rays on expected; leave it out")
        self.original, self.settings = Body.of(original), settings

    def __call__(self, result: Asset, folder: Path, progress: ProgressCallback = silent) -> dict[str, Any]:
        """
        Cast, fit, and write ``transfer.npz`` and what the report plays.

        Parameters
        ----------
        result : Asset
            The small model, as its file has it.
        folder : Path
            Of the two files; made.

        Returns
        -------
        dict
            ``psnr`` [dB], see :meth:`_measured`, and ``bytes`` of the textures, of coefficients at the vertices for
            each frame, and of no shadows; ``frames`` cast, ``axes`` kept.
        """
        small = Body.of(result)
        if any(part.material.alpha_mode != "OPAQUE" for part in self.original.asset.parts):
            log.warning("%s: transfer takes transparent surfaces for opaque ones", self.original.asset.name)
        if len(result.instances) > len({instance.part for instance in result.instances}):
            log.warning("%s: parts that are placed several times share the mean of their shadows", result.name)
        own = carried(self.original, small, self.settings, progress)
        folder.mkdir(parents=True, exist_ok=True)
        path = own.save(folder / FILE)
        if len(self.original.faces) <= MOST_TRIANGLES:
            write_atomic(folder / PLAYER, json.dumps(self._played(own, small)))
        n_vertices = len(small.posed(-1)[0])
        size = {"textures": path.stat().st_size, "vertices, every frame": 2 * len(own.frames) * n_vertices * own.n_k}
        return {
            "psnr": self._measured(own, small), "bytes": {**size, "no shadows": 0},
            "frames": len(own.frames), "axes": own.weights.shape[1],
        }  # fmt: skip

    def _measured(self, own: CarriedTransfer, small: Body) -> dict[str, dict[str, float]]:
        """
        PSNR of pictures halfway between cast frames, by what they are set against: ``asset``, rays cast where a pixel
        sees the original; ``places``, rays cast at the place of the original that the small model stands for there,
        which its shape has no part in.
        """
        middles = (own.frames[1:] + own.frames[:-1]) / 2 if len(own.frames) > 1 else own.frames
        middles = middles[np.unique(np.linspace(0, len(middles) - 1, N_PICTURES).astype(int))]
        bound, at_rest = small.posed(-1), self.original.posed(-1)[0]
        at_vertices = nearest(self.original, *bound)
        options: dict[str, Any] = {"order": own.order, "n_directions": self.settings.directions, "albedo": 1.0}
        by_pixel = Caster(at_rest, self.original.faces, n_points=SIZE**2, **options)
        by_vertex = Caster(at_rest, self.original.faces, n_points=len(at_vertices.corners), **options)
        errors: dict[str, dict[str, list[float]]] = {"asset": {}, "places": {}}
        for frame in middles.tolist():
            moved, _ = self.original.posed(frame)
            camera, same = Camera.around(moved, *VIEW), self._same(small, frame)
            there = seen(moved, self.original.faces, camera, SIZE)
            here = seen(small.posed(same)[0], small.faces, camera, SIZE)
            at = _places(here)
            stood_for = nearest(self.original, at.of(bound[0]), at.of(bound[1]))
            wanted = {
                "asset": _cast(by_pixel, self.original, _places(there), frame),
                "places": _cast(by_pixel, self.original, stood_for, frame),
            }
            assert small.uvs is not None
            shown = {
                "textures": lookup(at.of(small.uvs), self.settings.size) @ own.at(frame).reshape(-1, own.n_k),
                "vertices, every frame": at.of(_cast(by_vertex, self.original, at_vertices, frame)),
                "no shadows": unshadowed(at.posed(small, same)[2], own.order, 1.0),
            }
            both = (there.covered & here.covered).ravel() & is_lit(wanted["places"])
            if not both.any():
                continue
            for against, truth in wanted.items():
                for light in (sky(name, own.order) * GREY for name in SKIES):
                    target = tonemap(shade(truth, light))[both]
                    for name, transfer in shown.items():
                        error = float(((tonemap(shade(transfer, light))[both] - target) ** 2).mean())
                        errors[against].setdefault(name, []).append(-10 * np.log10(max(error, 1e-10)))
        return {k: {name: round(float(np.mean(v)), 2) for name, v in row.items()} for k, row in errors.items()}

    def _played(self, own: CarriedTransfer, small: Body) -> dict[str, Any]:
        """The original with rays at its vertices, beside the result with its textures."""
        positions = self.original.posed(-1)[0]
        n = int(np.clip(MOST_COEFFICIENTS // (len(positions) * own.n_k), 1, SHOWN))
        frames = np.unique(own.frames[np.linspace(0, len(own.frames) - 1, min(n, len(own.frames))).astype(int)])
        caster = Caster(
            positions, self.original.faces,
            order=own.order, n_directions=self.settings.directions, albedo=GREY,
        )  # fmt: skip
        theirs = [self.original.posed(f) for f in frames.tolist()]
        low, high = positions.min(0), positions.max(0)
        scale = 2 / np.linalg.norm(high - low)
        moved = [(p - (low + high) / 2) * scale for p, _ in theirs]
        ours = [(small.posed(self._same(small, f))[0] - (low + high) / 2) * scale for f in frames.tolist()]
        rays = np.stack([caster(p, n) for p, (_, n) in zip(moved, theirs, strict=True)])
        textures = GREY * np.stack([own.at(f) for f in frames.tolist()])
        return player_data([
            Surface(np.stack(moved), self.original.faces, {"asset, rays": rays}),
            Surface(np.stack(ours), small.faces, {"result, textures": textures}, small.uvs),
        ])  # fmt: skip

    def _same(self, small: Body, frame: float) -> float:
        """The frame of the small model's clip at the same time as one of the original's."""
        theirs, ours = self.original.asset.rig, small.asset.rig
        if theirs is None or ours is None:
            return 0.0
        return ours.frame_at(float(np.interp(frame, np.arange(theirs.n_frames), theirs.times)))


def _cast(caster: Caster, body: Body, places: Places, frame: float) -> np.ndarray:
    positions, points, normals = places.posed(body, frame)
    return caster(positions, normals, points)


def _places(hits: Hits) -> Places:
    return Places(hits.corners.reshape(-1, 3), hits.weights.reshape(-1, 3))
