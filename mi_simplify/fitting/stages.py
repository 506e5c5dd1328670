"""
What a step computes, stage by stage, and what each of them reads: declared once, for running it and for explaining it.
"""

from __future__ import annotations

from ..config import Config, FitSettings
from ..machine.reactive import Stage, affected

#: Of any fit. Inputs are what stands nowhere as a stage.
STAGES = (
    Stage("positions", ("vertices", "views"), "base positions through diffusion and mesh operation"),
    Stage("structure", ("positions",), "acceleration structure of the rays"),
    Stage("surface", ("positions",), "normals and tangents of the vertices"),
    Stage("hits", ("structure", "surface", "views", "samples"), "rays, what they meet, which texels they read"),
    Stage("image", ("hits", "surface", "textures", "light"), "texture lookups, shading, sums over pixels"),
    Stage("loss", ("image", "targets"), "image loss and its derivative by the image"),
)

#: What is done for the derivative by an input, where that is optimised.
BACKWARD = {
    "vertices": "derivatives of shading and of outlines, back through mesh operation and diffusion; Adam",
    "textures": "derivatives of shading, summed by texel; Adam",
    "light": "derivatives of shading by the ambient light; Adam",
}

#: Bytes of a kept hit, with what its texels need to find it again, and of all of them at most.
_PER_HIT, _MOST_KEPT = 150, 4 << 30

_OF_VERTICES = ("vertices", "displacement", "vertex_sets", "skinning", "weights")


def changing(settings: FitSettings, *, ambient: bool = False, is_opaque: bool = True) -> set[str]:
    """
    The inputs that are another in every step.

    Parameters
    ----------
    ambient : bool
        Whether the model has an ambient light.
    is_opaque : bool
        Of what is transparent, the textures decide what a ray meets: nothing of it is kept.
    """
    optimized = set(settings.latent.optimize)
    out: set[str] = set()
    if optimized & set(_OF_VERTICES):
        out.add("vertices")
    if optimized - set(_OF_VERTICES):
        out.add("textures")
    if ambient and settings.latent.ambient.optimize:
        out.add("light")
    if not can_keep(settings, is_opaque=is_opaque):  # where hits are kept, so are their samples
        out |= {"views", "samples"}
    return out | {"targets"}  # the colour behind them is another every time


def can_keep(settings: FitSettings, *, is_opaque: bool = True) -> bool:
    """
    Whether hits are the same in every step, fixed views of an opaque shape that stays, and memory holds them.
    """
    samples = settings.reference.pool * max(settings.optimizer.resolution) ** 2 * settings.optimizer.spp
    if samples * _PER_HIT > _MOST_KEPT:
        return False
    fixed = settings.reference.refresh == 0 and settings.optimizer.least_resolution is None
    still = not set(settings.latent.optimize) & set(_OF_VERTICES) and settings.reference.transport != "matched"
    exact = settings.optimizer.visibility == "edge" and settings.latent.mips == "none"
    return fixed and still and exact and is_opaque


def explained(config: Config, *, is_opaque: bool = True) -> list[tuple[str, bool, str]]:
    """
    Every stage of a step, whether it is computed in each, and what it reads and does.

    Parameters
    ----------
    config : Config
    is_opaque : bool

    Returns
    -------
    list of (name, is_computed, line)
    """
    ambient = config.latent.ambient.kind not in ("auto", "none")
    inputs = changing(config, ambient=ambient, is_opaque=is_opaque)
    computed = affected(STAGES, inputs)
    rows = [(s.name, s.name in computed, f"reads {', '.join(s.reads)}: {s.what}") for s in STAGES]
    return rows + [(f"gradient: {name}", True, what) for name, what in BACKWARD.items() if name in inputs]
