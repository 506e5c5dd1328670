"""
The first guess in the configuration.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .amounts import AtlasSize, Triangles
from .section import FilePath, Section, as_list

LARGEST_ATLAS = 1024
"""Side of the atlas that ``auto`` takes at most, and where it cannot know [texels]."""


class InitialSettings(Section):
    """The first guess."""

    kind: Literal["decimate", "cards", "auto", "sphere", "mesh"] = Field(
        "decimate",
        description="Decimate the asset, put its leaves on textured cards, `auto` whichever of these suits it, start "
        "from a sphere, or take the mesh of a file.",
    )
    triangles: Triangles = Field(
        None,
        description="Triangle budget of the result, a number from 4 on or a share of the asset's such as `30%`; none: "
        "3000, or as many as `mesh` has.",
    )
    vertices: int | None = Field(
        None,
        ge=8,
        description="Budget of vertices as files have them, split at seams and creases, instead of `triangles`.",
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
    keep_hidden: bool = Field(
        False,
        description="Keep parts that cannot be seen from outside, which else go first when decimating; always so where "
        "the asset has a skeleton.",
    )
    atlas_size: AtlasSize = Field(
        "auto",
        description="Width and height of the textures [texels], from 16 to 8192; `auto`: a power of two up to 1024, "
        "with room for the texels of the asset's own that it shows, or for four a removed vertex, if those are more.",
    )
    keep_nodes: Literal["auto", "all", "none"] = Field(
        "auto",
        description="Nodes of a glTF file that stay nodes, each with its name, transform and animation and a mesh of "
        "its own: those that are animated, `all` of them, or none, where animated ones become joints of a skeleton. "
        "Instances of a mesh stay instances, which are simplified once.",
    )
    keep: Annotated[tuple[str, ...], BeforeValidator(as_list)] = Field(
        (), description="Names of nodes that stay nodes besides."
    )
    crease_angle: float = Field(
        20.0,
        ge=0,
        le=180,
        description="Edges of the first guess that turn by more than this get two normals [degrees]; 180: all smooth.",
    )
    creases: Literal["all", "asset"] = Field(
        "all",
        description="Where such an edge gets them: everywhere, which takes two to three times the vertices, or where "
        "the asset has a hard edge, where a chart ends, and where `vertices_per_position` leaves room.",
    )
    vertices_per_position: float = Field(
        1.7,
        ge=1,
        le=6,
        description="Vertices a position, as files have them, up to which normals are split where faces that are seen "
        "are furthest from them; seams and hard edges of the asset may take more. Only with `creases: asset`.",
    )
    padding: int = Field(4, ge=1, le=64, description="Empty texels between charts.")
    textures: Literal["bake", "constant", "random"] = Field(
        "bake", description="Sample them from the asset, fill them with its mean, or with noise."
    )
    bake_occlusion: bool = Field(
        False,
        description="Cast rays on the asset for how much of the light from everywhere arrives at each place of it, and "
        "store that as occlusion texture, which viewers apply to such light; the fit leaves it alone. Where the asset "
        "has one of its own, the darker of both counts.",
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
    tessellations: Annotated[tuple[Annotated[int, Field(ge=0, le=5)], ...], BeforeValidator(as_list)] = Field(
        (),
        description="Subdivisions, up to `subdivisions`, that a displaced model is fitted for at once; none: that one.",
    )
    oversample: Literal[1, 2, 4, 8] = Field(
        1,
        description="Bake textures of so many times the side and filter them down, the spread of the normals below a "
        "texel becoming roughness.",
    )

    @property
    def atlas_side(self) -> int:
        """Side of the atlas; of ``auto``, which :func:`..initial.budget.settled` resolves, the largest."""
        return LARGEST_ATLAS if isinstance(self.atlas_size, str) else self.atlas_size

    @model_validator(mode="before")
    @classmethod
    def _usual_budget(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("kind") == "mesh":
            return data
        if data.get("triangles") is None and data.get("vertices") is None:
            return {**data, "triangles": 3000}
        return data

    @model_validator(mode="after")
    def _mesh_is_named(self) -> InitialSettings:
        if (self.kind == "mesh") != (self.mesh is not None):
            raise ValueError("`kind: mesh` and `mesh: FILE` go together, only one of them is set")
        if self.vertices is not None and (self.triangles is not None or self.kind == "mesh"):
            other = "kind: mesh" if self.kind == "mesh" else "triangles"
            raise ValueError(f"`vertices` and `{other}` do not go together, only one of them is the budget")
        if self.tessellations and max(self.tessellations) != self.subdivisions:
            raise ValueError("the largest of `tessellations` is `subdivisions`; set both")
        if self.source is not None and self.kind not in ("decimate", "auto"):
            raise ValueError("`source` is what `kind: decimate` reduces, which is not set")
        if self.keep_nodes == "all" or self.keep:
            if self.keep_nodes == "none":
                raise ValueError("`keep` names nodes to keep, `keep_nodes: none` keeps none; leave one of them out")
            if self.kind != "decimate" or self.source is not None or self.subdivisions or self.vertex_sets > 1:
                raise ValueError(
                    "`keep_nodes` and `keep` go with `kind: decimate`, without `source`, `subdivisions`, `vertex_sets`"
                )
        if self.bake_occlusion and (self.kind == "cards" or self.textures != "bake"):
            raise ValueError("`bake_occlusion` goes with `textures: bake`, and not with `kind: cards`")
        if self.keep_uv and self.mesh is None:
            raise ValueError("`keep_uv` is about the texture coordinates of `mesh: FILE`, which is not set")
        return self
