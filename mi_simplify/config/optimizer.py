"""
The optimisation in the configuration: its loop, its learning rates, and what is minimised.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from .section import Section, as_list, not_empty

Pixels = Annotated[int, Field(ge=8, le=8192)]
Resolutions = Annotated[tuple[Pixels, ...], BeforeValidator(as_list), AfterValidator(not_empty)]


class RatesSettings(Section):
    """Learning rates at the start."""

    vertices: float = Field(0.001, ge=0, description="Vertex positions: the typical step.")
    vertex_sets: float = Field(0.001, ge=0, description="Further vertex sets: the typical step.")
    displacement: float = Field(0.0005, ge=0, description="Displacement map: the typical step.")
    skinning: float = Field(0.03, ge=0, description="Logarithms of skinning weights.")
    weights: float = Field(0.01, ge=0, description="Weights of morph targets.")
    base_color: float = Field(0.001, ge=0, description="Base colour and opacity.")
    specular: float = Field(0.001, ge=0, description="Gamma, roughness and metallic.")
    normal: float = Field(0.001, ge=0, description="Normal map.")
    opacity: float | None = Field(None, ge=0, description="Opacity; none: as the base colour.")
    roughness: float | None = Field(None, ge=0, description="Roughness; none: `specular`.")
    metallic: float | None = Field(None, ge=0, description="Metalness; none: `specular`.")
    ambient: float = Field(0.01, ge=0, description="Ambient light.")


class LargeStepsSettings(Section):
    """Vertices through the diffusion of Nicolet et al. 2021."""

    enabled: bool = Field(True, description="Precondition vertex gradients by (I + lambda L); off: plain Adam.")
    lambda_: float = Field(0.3, ge=0, description="Diffusion strength: 0.2 to 0.5 on a decimated mesh, 19 on a sphere.")


class HardSoftSettings(Section):
    """Soft outlines (HardSoftRas, Takimoto et al. 2022); lengths in halves of the film's width."""

    radius: float = Field(0.01, gt=0, le=1, description="r: how far from an outline the image is soft.")
    sigma: float | None = Field(None, gt=0, description="Width of the blend; none: a seventh of `radius`.")
    delta: float | None = Field(None, gt=0, description="Width of the edge mask; none: `radius`.")
    until: float = Field(
        1.0, ge=0, le=1, description="Share of the steps that are soft; those after it are exact (`edge`)."
    )


class OptimizerSettings(Section):
    """The optimisation loop."""

    steps: int = Field(150, ge=0, description="Number of steps at most; 0 exports the first guess.")
    tolerance: float = Field(
        0.005,
        ge=0,
        lt=1,
        description="Least share by which the held-out loss falls from one measurement to the next "
        "(`evaluation.every`); where it falls by less, the rates run out within as many steps and the fit ends. 0: all "
        "steps are done.",
    )
    time: float | None = Field(
        None,
        gt=0,
        description="Seconds of the job after which the fit ends with the best model by then; loading and the first "
        "guess count, export and evaluation follow. Rates fall in step with the time used. none: no limit.",
    )
    batch: int = Field(8, ge=1, le=1024, description="Views per step.")
    resolution: Resolutions = Field(
        (256,), description="Image width and height [px], or a list of them from coarse to fine."
    )
    target_resolution: Pixels | None = Field(
        None,
        description="Prefilter: make the model for images of this size, where one sample per pixel is to show what "
        "many show of the asset. Resolution, batch, samples, textures and `shade` then have other defaults.",
    )
    least_resolution: Pixels | None = Field(
        None,
        description="Random resolutions from `resolution` down to this one, a step's pixels staying as many; none: "
        "`resolution` alone.",
    )
    spp: int = Field(2, ge=1, le=65536, description="Samples per pixel of a latent image.")
    shade: Literal["sample", "pixel"] = Field(
        "sample",
        description="Shade every sample, or only one in each pixel: more samples then make outlines smooth, but not "
        "what textures and normals make of a pixel.",
    )
    visibility: Literal["edge", "hard_soft"] = Field(
        "edge",
        description="Derivatives of what is visible: `edge`, exact, by samples on outlines; `hard_soft`, of images "
        "whose outlines are soft, which reach farther. Opaque models only.",
    )
    hard_soft: HardSoftSettings = HardSoftSettings()
    rates: RatesSettings = RatesSettings()
    decay: float = Field(0.05, gt=0, le=1, description="Factor by which the rates fall over the whole run.")
    large_steps: LargeStepsSettings = LargeStepsSettings()


class LaplacianSettings(Section):
    """The mesh regulariser."""

    weight: float = Field(0.25, ge=0, description="Share of the image loss at the start; 0: off.")
    relative: bool = Field(True, description="Penalise the difference to the first guess instead of curvature itself.")
    decay_to: float = Field(0.02, ge=0, le=1, description="Factor by which the weight falls over the whole run.")


class LossSettings(Section):
    """What is minimised."""

    image: str = Field(
        "log_l1",
        description="Image loss: `log_l1`, which compares tone-mapped log(x + 1), `l1`, `l2`, `log_l2`, `smape`, "
        "`relative_l2`, or one that an extension registers.",
    )
    coverage: float = Field(3.0, ge=0, description="Weight of the coverage (silhouette) term.")
    laplacian: LaplacianSettings = LaplacianSettings()
