"""
The GLB file in the configuration.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .amounts import Bytes
from .section import Section


class GlbSettings(Section):
    """How a GLB file is packed: what it holds is the same, how exactly and in how many bytes is not."""

    compress: Literal["none", "quantize", "meshopt"] = Field(
        "none",
        description="Geometry: 32-bit floats; `quantize`: integers of 8 and 16 bits (KHR_mesh_quantization); `meshopt`:"
        " those, compressed (EXT_meshopt_compression).",
    )
    tangents: bool = Field(
        True,
        description="Store MikkTSpace tangents where there is a normal map, 16 bytes a vertex; without them a viewer "
        "makes its own.",
    )
    textures: Literal["png", "jpeg", "webp", "ktx2"] = Field(
        "png",
        description="Images: lossless PNG; JPEG, but for images with opacity, which stay PNG; WebP (EXT_texture_webp); "
        "KTX2 (KHR_texture_basisu) with mip levels of our own, encoded by the program `basisu`.",
    )
    quality: int = Field(
        90,
        ge=1,
        le=100,
        description="Of images of colours that are not PNG; 100: lossless in WebP. KTX2 is UASTC from 95 on, else "
        "ETC1S.",
    )
    data_quality: int = Field(
        100,
        ge=1,
        le=100,
        description="The same, of normals, roughness and metalness. From 80 on WebP rounds normals to "
        "steps and stores these losslessly.",
    )
    color_size: int | None = Field(
        None,
        ge=4,
        le=8192,
        description="Largest side of images of colours [texels], a power of two; none: the atlas's",
    )
    normal_size: int | None = Field(None, ge=4, le=8192, description="The same, of the normal map.")
    orm_size: int | None = Field(None, ge=4, le=8192, description="The same, of roughness and metalness.")

    max_bytes: Bytes = Field(
        None,
        description="Largest size of the file, such as `500kB` or `1.5MB`: what stands above and nobody has stated is "
        "chosen by what pictures of the model lose. None: no limit.",
    )

    @property
    def is_lossless(self) -> bool:
        """Whether images hold every texel to the 8 bits that it is rounded to."""
        exact = self.textures == "png" or (self.textures == "webp" and self.quality == self.data_quality == 100)
        return exact and self.color_size is self.normal_size is self.orm_size is None
