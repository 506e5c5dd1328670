"""
A character: an asset with a skeleton and an animation, fitted and judged in many frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..config import Config
from ..config.animation import AnimationSettings
from ..config.presets import STARTS
from ..errors import ConfigError
from ..initial.reduce.weights import bone_weights, carried_weights
from ..judging.comparison import Comparison
from ..judging.evaluate import Judging
from ..judging.frames import compare_characters
from ..judging.pruning import pruning_cost
from ..model.asset import Asset, rig_of
from ..model.model import Model
from ..model.rig import BIND_POSE, Rig
from ..model.rigging import Rigging
from ..progress import ProgressCallback
from ..scenes.references.reference import Reference
from .subject import Subject, reference_for, renderer_of


class Character(Subject):
    """
    An asset with a rig, shown in the frames of its clip.

    Parameters
    ----------
    config : Config
    geometry : Asset
        In its bind pose.

    Attributes
    ----------
    fitted, judged : ndarray, shape (N,)
        Frames that the fit sees, and those that are kept for the verdict.
    """

    keeps_nodes = True

    def __init__(self, config: Config, geometry: Asset):
        config = config.started(STARTS["character"])
        if config.initial.kind == "sphere":
            config = config.started(STARTS["sphere of a character"])
        super().__init__(config, geometry)
        self.fitted, self.judged = split_frames(rig_of(geometry), config.animation)

    @property
    def display(self) -> Asset:
        """See :class:`.subject.Subject`."""
        return self.geometry

    def guess(self) -> tuple[Model, list[str]]:
        """
        See :class:`.subject.Subject`: a first guess of the bind pose, with weights.
        """
        model, notes = self._first_guess()
        if model.displacement is not None or model.vertex_sets is not None:
            raise ConfigError("a character has one vertex set and no displacement map; leave both out of `initial`")
        by_bones = self.config.initial.kind == "sphere"
        return self._with_weights(model, by_bones), notes

    def baseline(self, triangles: int) -> Model:
        """
        See :class:`.subject.Subject`: decimated in the bind pose, weights carried over.
        """
        model = self._quadrics(triangles)
        asset = self.frame.normalised(self.geometry)
        weights = carried_weights(asset, model.mesh)
        rigging = Rigging(weights, rig_of(asset), boxes(asset), self.fitted, self.config.animation.influences)
        return replace(model, skin=rigging)

    def _with_weights(self, model: Model, by_bones: bool = False) -> Model:
        asset = self.frame.normalised(self.shown)
        rig = rig_of(asset)
        fitted, reach = self.fitted, 0.0
        if model.nodes is not None:
            joints = np.array([placed[0] for placed in model.nodes.joints])
            weights = np.eye(len(rig.names), dtype=np.float32)[joints[model.nodes.of_position]]
            rigging = Rigging(weights, rig, boxes(asset), fitted, self.config.animation.influences, rigid=True)
            return replace(model, skin=rigging)
        if by_bones:  # where limbs are spread, so that a sphere finds them: every other instant
            weights, reach = bone_weights(rig, model.mesh.positions)
            fitted = np.concatenate([fitted, np.full(len(fitted), BIND_POSE)])
        else:
            weights = carried_weights(asset, model.mesh)
        # Where joints carry whole parts, no vertex follows two of them: weights that the fit gave a part beside its own
        # would have a body turn with its wheels.
        rigid = not by_bones and all(part.skin is None for part in asset.parts)
        rigging = Rigging(weights, rig, boxes(asset), fitted, self.config.animation.influences, reach, rigid)
        return replace(model, skin=rigging)

    def reference(self) -> Reference:
        """See :class:`.subject.Subject`."""
        return reference_for(self.frame.normalised(self.shown), self.config)

    def renderer(self, spp: int) -> Reference:
        """See :class:`.subject.Subject`."""
        return renderer_of(self.geometry, self.config, spp)

    def facts(self, model: Model) -> dict[str, Any]:
        """
        See :class:`.subject.Subject`: what it costs that files keep few joints a vertex.
        """
        if model.skin is not None and model.skin.rigid:
            return {}
        return {"pruning": pruning_cost(model, form=self.config.latent.shading)}

    def judge(
        self,
        candidates: Mapping[str, Asset],
        judging: Judging = Judging(),
        progress: ProgressCallback | None = None,
    ) -> Comparison:
        """
        See :class:`.subject.Subject`: candidates are posed in the same frames.
        """
        return compare_characters(self.geometry, candidates, self.judged, judging, progress, self.kept)


def split_frames(rig: Rig, animation: AnimationSettings) -> tuple[np.ndarray, np.ndarray]:
    """
    Frames to fit and frames to judge by, as indices into the clip.

    Of fewer than three frames none is kept out, and all are judged.

    Raises
    ------
    ConfigError
        None of the clip is asked for.
    """
    chosen = np.arange(rig.n_frames)
    if animation.frames is not None:
        first, last, *step = (float(x) for x in animation.frames.split(":"))
        chosen = np.flatnonzero((rig.codes >= first) & (rig.codes <= last))[:: int(step[0]) if step else 1]
        if not len(chosen):
            raise ConfigError(
                f"animation.frames: {animation.frames} holds no frame of the clip, which goes from "
                f"{rig.codes[0]:g} to {rig.codes[-1]:g}"
            )
    n = min(animation.held_out, len(chosen) // 3)
    held_out = chosen[((np.arange(n) + 0.5) * len(chosen) / n).astype(np.int64)] if n else chosen
    fitted = np.setdiff1d(chosen, held_out) if n else chosen
    return np.array([BIND_POSE]) if animation.bind_pose_only else fitted, held_out


def boxes(asset: Asset) -> np.ndarray:
    """
    Where a character is in each frame, and last in its bind pose, shape (T + 1, 2, 3).

    A sample of its vertices is looked at, those on its outside in the bind pose among them.
    """
    parts, rig = asset.placed(), rig_of(asset)
    points = np.concatenate([p.vertices for p in parts])
    used = np.concatenate([np.isin(np.arange(len(p.vertices)), p.faces) for p in parts])
    far = [f(points @ d) for f in (np.argmax, np.argmin) for d in np.eye(3)]
    index = np.flatnonzero(used)
    index = np.unique(np.concatenate([index[:: max(1, len(index) // _SAMPLED)], far]))
    points, weights = points[index], asset.influences()[index]
    out = []
    for frame in (*range(rig.n_frames), BIND_POSE):
        flat = (weights @ rig.matrices(frame)[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
        moved = np.einsum("vij,vj->vi", flat[..., :3], points) + flat[..., 3]
        out.append([moved.min(0), moved.max(0)])
    return np.array(out)


_SAMPLED = 20_000
