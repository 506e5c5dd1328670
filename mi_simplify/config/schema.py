"""
Every setting with its type, range, default and meaning: one frozen model per section of the YAML.

The defaults stand here and nowhere else. Lengths are in the normalised frame (the asset's box has
side 2 and centre 0), angles in degrees, colours linear.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from .ambient import Ambient
from .animation import Animation
from .images import Images
from .implicit import Implicit
from .opacity import Opacity
from .section import FilePath as FilePath
from .section import PathMark as PathMark
from .section import Section as Section
from .section import Triple


def _as_list(value: Any) -> Any:
    """A single value stands for a list of one."""
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _not_empty(value: tuple) -> tuple:
    if not value:
        raise ValueError("should hold at least one value")
    return value


def _distinct(value: tuple) -> tuple:
    if len(set(value)) != len(value):
        raise ValueError("should name nothing twice")
    return value


Pixels = Annotated[int, Field(ge=8, le=8192)]
Resolutions = Annotated[tuple[Pixels, ...], BeforeValidator(_as_list), AfterValidator(_not_empty)]
Quantity = Literal[
    "vertices",
    "displacement",
    "vertex_sets",
    "skinning",
    "base_color",
    "opacity",
    "gamma",
    "roughness",
    "metallic",
    "normal",
]
Quantities = Annotated[tuple[Quantity, ...], BeforeValidator(_as_list), AfterValidator(_distinct)]
Format = Literal["glb", "obj", "usd"]
Formats = Annotated[
    tuple[Format, ...], BeforeValidator(_as_list), AfterValidator(_not_empty), AfterValidator(_distinct)
]


class Reference(Section):
    """How the target images are rendered."""

    transport: Literal["direct", "baked", "matched"] = Field(
        "direct",
        description="`direct`: direct light without shadows on both sides, materials stay clean. `baked`: full path "
        "tracing, shadows and indirect light end up in the textures. `matched`: full path tracing, and what the small "
        "model's direct light lacks is added to it as a constant, so that materials stay clean.",
    )
    spp: int = Field(16, ge=1, le=65536, description="Samples per pixel of a reference image.")
    max_depth: int = Field(6, ge=2, le=1024, description="Longest light path, in edges; only path tracing reads it.")
    pool: int = Field(128, ge=1, description="Rendered views held ready; a step draws its batch from them.")
    refresh: int = Field(2, ge=0, description="Views of the pool rendered anew per step; 0 keeps the first ones.")
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

    @model_validator(mode="after")
    def _lights_are_baked(self) -> Reference:
        for name, given in (("environment", self.environment is not None), ("scene_lights", self.scene_lights)):
            if given and self.transport != "baked":
                raise ValueError(f"`{name}` lights the reference alone, so it needs `transport: baked`")
        return self


class Initial(Section):
    """The first guess."""

    kind: Literal["decimate", "cards", "sphere", "mesh"] = Field(
        "decimate",
        description="Decimate the asset, put its leaves on textured cards, start from a sphere, or take the mesh of a "
        "file.",
    )
    triangles: int | None = Field(
        None, ge=4, description="Triangle budget of the result; none: 3000, or as many as `mesh` has."
    )
    mesh: FilePath | None = Field(
        None,
        description="Mesh file to start from, in the asset's place and size; only with `kind: mesh`. Its textures are "
        "not read, its texture coordinates are kept where they do not overlap.",
    )
    source: FilePath | None = Field(
        None,
        description="Model that `kind: decimate` reduces and bakes from, instead of the asset, in its place.",
    )
    keep_uv: bool = Field(
        False, description="Refuse a `mesh` whose texture coordinates cannot be kept instead of unwrapping it anew."
    )
    repair: bool = Field(
        True,
        description="Mend a damaged `mesh` by the asset before it is fitted: pieces that came off, stray vertices, "
        "lost volume; only where `vertices` are fitted.",
    )
    atlas_size: int = Field(1024, ge=16, le=8192, description="Width and height of the textures [texels].")
    crease_angle: float = Field(
        20.0,
        ge=0,
        le=180,
        description="Edges of the first guess that turn by more than this get two normals [degrees]; 180: all smooth.",
    )
    textures: Literal["bake", "constant", "random"] = Field(
        "bake", description="Sample them from the asset, fill them with its mean, or with noise."
    )
    vertex_sets: int = Field(
        1,
        ge=1,
        le=8,
        description="Sets of vertex positions over one topology, for sizes that halve from `optimizer.resolution` down "
        "and are blended between them; needs `optimizer.least_resolution`.",
    )
    subdivisions: int = Field(
        0,
        ge=0,
        le=5,
        description="Split every triangle in four so many times and displace what comes of it by a map; `triangles` "
        "are those before.",
    )
    tessellations: Annotated[tuple[Annotated[int, Field(ge=0, le=5)], ...], BeforeValidator(_as_list)] = Field(
        (),
        description="Subdivisions, up to `subdivisions`, that a displaced model is fitted for at once; none: that one.",
    )
    oversample: Literal[1, 2, 4, 8] = Field(
        1,
        description="Bake textures of so many times the side and filter them down, the spread of the normals below a "
        "texel becoming roughness.",
    )

    @model_validator(mode="before")
    @classmethod
    def _usual_budget(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("triangles") is None and data.get("kind") != "mesh":
            return {**data, "triangles": 3000}
        return data

    @model_validator(mode="after")
    def _mesh_is_named(self) -> Initial:
        if (self.kind == "mesh") != (self.mesh is not None):
            raise ValueError("`kind: mesh` and `mesh: FILE` go together, only one of them is set")
        if self.tessellations and max(self.tessellations) != self.subdivisions:
            raise ValueError("the largest of `tessellations` is `subdivisions`; set both")
        if self.source is not None and self.kind != "decimate":
            raise ValueError("`source` is what `kind: decimate` reduces, which is not set")
        if self.keep_uv and self.mesh is None:
            raise ValueError("`keep_uv` is about the texture coordinates of `mesh: FILE`, which is not set")
        return self


class Latent(Section):
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
    ambient: Ambient = Ambient()
    mips: Literal["none", "derived", "custom"] = Field(
        "none",
        description="Coarser levels of the textures, read by the size of a pixel: none; `derived` by averaging, as "
        "viewers do; `custom`: each level is fitted by itself.",
    )


class Light(Section):
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


class Views(Section):
    """Random cameras and lights."""

    distance: float = Field(3.5, gt=0, description="Camera distance from the centre.")
    jitter: float = Field(0.25, ge=0, description="Half side of the box around the centre that cameras look into.")
    fov: float = Field(45.0, gt=0, lt=180, description="Field of view [degrees].")
    light: Light = Light()
    background: Literal["random", "black"] = Field(
        "random", description="`random`: one random colour per pixel, the same behind both images."
    )


class Rates(Section):
    """Learning rates at the start."""

    vertices: float = Field(0.001, ge=0, description="Vertex positions: the typical step.")
    vertex_sets: float = Field(0.001, ge=0, description="Further vertex sets: the typical step.")
    displacement: float = Field(0.0005, ge=0, description="Displacement map: the typical step.")
    skinning: float = Field(0.03, ge=0, description="Logarithms of skinning weights.")
    base_color: float = Field(0.001, ge=0, description="Base colour and opacity.")
    specular: float = Field(0.001, ge=0, description="Gamma, roughness and metallic.")
    normal: float = Field(0.001, ge=0, description="Normal map.")
    ambient: float = Field(0.01, ge=0, description="Ambient light.")


class LargeSteps(Section):
    """Vertices through the diffusion of Nicolet et al. 2021."""

    enabled: bool = Field(True, description="Precondition vertex gradients by (I + lambda L); off: plain Adam.")
    lambda_: float = Field(0.3, ge=0, description="Diffusion strength: 0.2 to 0.5 on a decimated mesh, 19 on a sphere.")


class Optimizer(Section):
    """The optimisation loop."""

    steps: int = Field(600, ge=0, description="Number of steps; 0 exports the first guess.")
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
    rates: Rates = Rates()
    decay: float = Field(0.05, gt=0, le=1, description="Factor by which the rates fall over the whole run.")
    large_steps: LargeSteps = LargeSteps()


class Laplacian(Section):
    """The mesh regulariser."""

    weight: float = Field(0.25, ge=0, description="Share of the image loss at the start; 0: off.")
    relative: bool = Field(True, description="Penalise the difference to the first guess instead of curvature itself.")
    decay_to: float = Field(0.02, ge=0, le=1, description="Factor by which the weight falls over the whole run.")


class Loss(Section):
    """What is minimised."""

    image: Literal["log_l1", "l1", "l2", "log_l2", "smape", "relative_l2"] = Field(
        "log_l1", description="Image loss; `log_l1` compares tone-mapped log(x + 1)."
    )
    coverage: float = Field(3.0, ge=0, description="Weight of the coverage (silhouette) term.")
    laplacian: Laplacian = Laplacian()


class Evaluation(Section):
    """Held-out views: never fitted, rendered for figures and pictures."""

    views: int = Field(8, ge=1, le=1024, description="Number of views.")
    resolution: int = Field(256, ge=16, le=8192, description="Image width and height [px].")
    spp: int = Field(64, ge=1, le=65536, description="Samples per pixel.")
    every: int = Field(50, ge=1, description="Steps between two measurements of PSNR while the fit runs.")
    light: Literal["relit", "fitted"] = Field(
        "relit",
        description="`relit`: path traced, in light that the fit has not seen. `fitted`: the reference as it was fitted"
        " to, and the result lit directly, for what is baked on purpose; always so for what is no model file.",
    )
    baseline: bool = Field(
        False, description="Judge quadric decimation with colours carried over and flat normals as well."
    )


class Export(Section):
    """What is written."""

    formats: Formats = Field(("glb", "obj", "usd"), description="Model files to write.")
    checkpoint: float = Field(
        30.0, ge=0, description="Seconds between two checkpoints, from which `--resume` goes on; 0: after every step."
    )
    tensorboard: bool = Field(False, description="Also write the course of the fit for TensorBoard, a package apart.")


class Config(Section):
    """One job: from the asset to the exported model."""

    asset: FilePath = Field(
        description="Model file; `sample:NAME` for one made by code (relic, shrub, creature); `package.module:NAME` or "
        "`file.py:NAME` for an implicit surface, which runs that Python code; `transforms.json` for captured images."
    )
    preset: Literal["fast", "balanced", "best"] | None = Field(
        None, description="Overrides that lie between the defaults and everything set here."
    )
    seed: int = Field(0, ge=0, lt=2**31, description="Seed of every random number of the run.")
    variant: Literal["llvm_ad_rgb", "cuda_ad_rgb"] | None = Field(
        None, description="Mitsuba variant; none takes the environment's `MI_SIMPLIFY_VARIANT`, else `llvm_ad_rgb`."
    )
    reference: Reference = Reference()
    implicit: Implicit = Implicit()
    images: Images = Images()
    initial: Initial = Initial()
    latent: Latent = Latent()
    opacity: Opacity = Opacity()
    views: Views = Views()
    animation: Animation = Animation()
    optimizer: Optimizer = Optimizer()
    loss: Loss = Loss()
    evaluation: Evaluation = Evaluation()
    export: Export = Export()

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
            if asked and size & (size - 1):
                raise ValueError(f"`{key}` needs an `initial.atlas_size` that is a power of two, it is {size}")
        return self
