"""
Every setting with its type, range, default and meaning: one frozen model per section of the YAML.

The defaults stand in this folder and nowhere else, those of larger sections in modules of their own. Lengths are in the
normalised frame (the asset's box has side 2 and centre 0), angles in degrees, colours linear.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from .amounts import GoalSettings
from .animation import AnimationSettings
from .export import CarriedSettings
from .glb import GlbSettings as GlbSettings
from .initial import InitialSettings
from .inputs import ImagesSettings, ImplicitSettings
from .latent import AmbientSettings, OpacitySettings
from .optimizer import LossSettings, OptimizerSettings
from .section import FilePath as FilePath
from .section import PathMark as PathMark
from .section import Section as Section
from .section import Triple, as_list, distinct, not_empty

Quantity = Literal[
    "vertices",
    "displacement",
    "vertex_sets",
    "skinning",
    "weights",
    "base_color",
    "opacity",
    "gamma",
    "roughness",
    "metallic",
    "normal",
]
Quantities = Annotated[tuple[Quantity, ...], BeforeValidator(as_list), AfterValidator(distinct)]
Formats = Annotated[tuple[str, ...], BeforeValidator(as_list), AfterValidator(not_empty), AfterValidator(distinct)]


class ReferenceSettings(Section):
    """How the target images are rendered."""

    transport: Literal["direct", "baked", "matched"] = Field(
        "direct",
        description="`direct`: direct light without shadows on both sides, materials stay clean. `baked`: full path "
        "tracing, shadows and indirect light end up in the textures. `matched`: full path tracing, and what the small "
        "model's direct light lacks is added to it as a constant, so that materials stay clean.",
    )
    spp: int | None = Field(
        None,
        ge=1,
        le=65536,
        description="Samples per pixel of a reference image. none: in direct light those of the "
        "latent images, at the same places, so that their noise cancels; otherwise 4, and 16 where paths are traced.",
    )
    max_depth: int = Field(6, ge=2, le=1024, description="Longest light path, in edges; only path tracing reads it.")
    pool: int = Field(128, ge=1, description="Rendered views held ready; a step draws its batch from them.")
    refresh: int = Field(1, ge=0, description="Views of the pool rendered anew per step; 0 keeps the first ones.")
    environment: FilePath | None = Field(
        None, description="Environment map (EXR or HDR) besides the point light; only with `transport: baked`."
    )
    renderer: Literal["mitsuba", "vtk"] = Field(
        "mitsuba", description="What renders a model file; `vtk`, a package apart, is a rasteriser without shadows."
    )
    command: str | None = Field(
        None,
        min_length=1,
        description="A program of your own that renders instead: it is started with a `transforms.json` of views and "
        "writes their images, see How it works.",
    )
    scene_lights: bool = Field(
        False, description="Keep the lights of a Mitsuba scene besides the point light; only with `transport: baked`."
    )

    @property
    def samples(self) -> int:
        """Samples per pixel of an image that is looked at by itself."""
        return 4 if self.spp is None else self.spp

    def supersampled(self) -> ReferenceSettings:
        """The same with so many samples that their noise does not count."""
        return self.model_copy(update={"spp": max(self.samples, 64)})

    @model_validator(mode="after")
    def _lights_are_baked(self) -> ReferenceSettings:
        for name, given in (("environment", self.environment is not None), ("scene_lights", self.scene_lights)):
            if given and self.transport != "baked":
                raise ValueError(f"`{name}` lights the reference alone, so it needs `transport: baked`")
        return self


class LatentSettings(Section):
    """What is optimised, and how it is shaded."""

    optimize: Quantities = Field(
        ("vertices", "displacement", "vertex_sets", "skinning", "base_color", "roughness", "metallic", "normal"),
        description="Quantities that the fit changes; `displacement` and `vertex_sets` only where there are any, "
        "`skinning`, the weights of joints, only where there is a skeleton.",
    )
    min_roughness: float = Field(0.08, ge=0.01, le=1.0, description="Lower limit of roughness.")
    shading: Literal["gltf", "paper"] = Field(
        "gltf", description="`gltf`: as glTF viewers shade. `paper`: Lambert plus specular, without energy exchange."
    )
    ambient: AmbientSettings = AmbientSettings()
    mips: Literal["none", "derived", "custom"] = Field(
        "none",
        description="Coarser levels of the textures, read by the size of a pixel: none; `derived` by averaging, as "
        "viewers do; `custom`: each level is fitted by itself.",
    )


class LightSettings(Section):
    """The one point light of a view."""

    exponent: float = Field(1.0, ge=0, description="Directions follow cos^exponent around the camera's; 0: evenly.")
    position: Triple | None = Field(
        None,
        description="Where the light stands in all views, in the normalised frame; none: it goes around with the "
        "camera. A static light lets shadows be painted into the textures (`transport: baked`).",
    )
    irradiance: float = Field(
        2.5, gt=0, description="Irradiance at the centre per channel; π shows a white diffuse surface with radiance 1."
    )


class ViewsSettings(Section):
    """Random cameras and lights."""

    distance: float = Field(3.5, gt=0, description="Camera distance from the centre.")
    jitter: float = Field(0.25, ge=0, description="Half side of the box around the centre that cameras look into.")
    fov: float = Field(45.0, gt=0, lt=180, description="Field of view [degrees].")
    light: LightSettings = LightSettings()
    background: Literal["random", "black"] = Field(
        "random", description="`random`: one random colour per pixel, the same behind both images."
    )


class EvaluationSettings(Section):
    """Held-out views: never fitted, rendered for figures and pictures."""

    views: int = Field(8, ge=1, le=1024, description="Number of views.")
    resolution: int = Field(256, ge=16, le=8192, description="Image width and height [px].")
    spp: int = Field(16, ge=1, le=65536, description="Samples per pixel.")
    every: int = Field(25, ge=1, description="Steps between two measurements of PSNR while the fit runs.")
    light: Literal["relit", "fitted"] = Field(
        "relit",
        description="`relit`: path traced, in light that the fit has not seen. `fitted`: the reference as it was fitted"
        " to, and the result lit directly, for what is baked on purpose; always so for what is no model file.",
    )
    baseline: bool = Field(
        False, description="Judge quadric decimation with colours carried over and flat normals as well."
    )


class ExportSettings(Section):
    """What is written."""

    formats: Formats = Field(
        ("glb", "obj", "usd"), description="Model files to write: `glb`, `obj`, `usd`, or what an extension registers."
    )
    glb: GlbSettings = GlbSettings()
    transfer: CarriedSettings = CarriedSettings()
    metadata: bool = Field(True, description="Carry over the asset's copyright notice and the extras of its file.")
    checkpoint: float = Field(
        30.0, ge=0, description="Seconds between two checkpoints, from which `--resume` goes on; 0: after every step."
    )
    tensorboard: bool = Field(False, description="Also write the course of the fit for TensorBoard, a package apart.")


class FitSettings(Section):
    """What :func:`mi_simplify.fit` reads: rates, schedule, loss, views, and how the latent model is shaded."""

    seed: int = Field(0, ge=0, lt=2**31, description="Seed of every random number of the run.")
    reference: ReferenceSettings = ReferenceSettings()
    latent: LatentSettings = LatentSettings()
    opacity: OpacitySettings = OpacitySettings()
    views: ViewsSettings = ViewsSettings()
    optimizer: OptimizerSettings = OptimizerSettings()
    loss: LossSettings = LossSettings()
    evaluation: EvaluationSettings = EvaluationSettings()


class Config(FitSettings):
    """One job: from the asset to the exported model."""

    asset: FilePath = Field(
        description="Model file; `sample:NAME` for one made by code (relic, shrub, creature); `package.module:NAME` or "
        "`file.py:NAME` for an implicit surface, which runs that Python code; `transforms.json` for captured images."
    )
    preset: Literal["fast", "balanced", "best"] | None = Field(
        None, description="Overrides that lie between the defaults and everything set here."
    )
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb"] | None = Field(
        None, description="Mitsuba variant; none takes the environment's `MI_SIMPLIFY_VARIANT`, else `llvm_ad_rgb`."
    )
    extensions: Annotated[tuple[FilePath, ...], BeforeValidator(as_list)] = Field(
        (),
        description="Python files or modules of your own, run before the job: they register losses, mesh operations, "
        "subjects, readers and writers.",
    )
    implicit: ImplicitSettings = ImplicitSettings()
    images: ImagesSettings = ImagesSettings()
    initial: InitialSettings = InitialSettings()
    goal: GoalSettings = GoalSettings()
    animation: AnimationSettings = AnimationSettings()
    export: ExportSettings = ExportSettings()

    @model_validator(mode="before")
    @classmethod
    def _budget_or_goal(cls, data: Any) -> Any:
        initial, goal = ((data.get(name) if isinstance(data, dict) else None) or {} for name in ("initial", "goal"))
        if isinstance(initial, Mapping) and isinstance(goal, Mapping):
            sizes = [f"initial.{name}" for name in ("triangles", "vertices") if initial.get(name) is not None]
            goals = [f"goal.{name}" for name, value in goal.items() if value is not None]
            if sizes and goals:
                raise ValueError(f"`{sizes[0]}` and `{goals[0]}` both say how large the result is; name one of them")
        return data

    @model_validator(mode="after")
    def _bytes_are_those_of_a_glb(self) -> Config:
        if self.export.glb.max_bytes is not None and "glb" not in self.export.formats:
            raise ValueError("`export.glb.max_bytes` is about the GLB file, which `export.formats` leaves out")
        return self

    @model_validator(mode="after")
    def _vertex_sets_are_seen(self) -> Config:
        if self.initial.vertex_sets > 1:
            if self.optimizer.least_resolution is None:
                raise ValueError("`initial.vertex_sets` are for several sizes: set `optimizer.least_resolution`")
            if self.initial.subdivisions:
                raise ValueError("`initial.vertex_sets` and `initial.subdivisions` do not go together; choose one")
        return self

    @model_validator(mode="after")
    def _mips_can_be_halved(self) -> Config:
        size = self.initial.atlas_size
        for key, asked in (("latent.mips", self.latent.mips != "none"), ("oversample", self.initial.oversample > 1)):
            if asked and isinstance(size, int) and size & (size - 1):
                raise ValueError(f"`{key}` needs an `initial.atlas_size` that is a power of two, it is {size}")
        return self


def asset_first(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    What goes by the keys of a job in the order that a person reads them: those of the job before those of its fit.
    """
    return {key: values[key] for key in (*(k for k in values if k not in FitSettings.model_fields), *values)}
