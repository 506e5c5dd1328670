"""
A morphable face and the portraits that it is fitted to: what is minimised, and how fast everything moves.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from ..layers import read_yaml
from ..problems import validated
from ..section import Section, Triple, as_list


class FaceLoss(Section):
    """Weights of the terms that are minimised, each a mean; lengths in halves of the model's or the film's size."""

    landmarks: float = Field(1.0, ge=0, description="Distance of landmarks on the film, L1.")
    depth: float = Field(5.0, ge=0, description="Difference of depth, L1 up to `truncation`.")
    truncation: float = Field(0.05, gt=0, description="Difference from which depth does not count.")
    color: float = Field(3.0, ge=0, description="Squared difference of linear radiance.")
    coverage: float = Field(0.1, ge=0, description="Squared difference of coverage, where images have a mask.")
    weights: float = Field(0.0003, ge=0, description="Squares of the weights.")
    textures: float = Field(0.02, ge=0, description="Squared distance of texels from their start.")


class FaceRates(Section):
    """Typical step of each quantity at the start."""

    pose: float = Field(0.003, ge=0, description="Of rotations [radians] and translations.")
    scale: float = Field(0.003, ge=0, description="Of the logarithm of the scale; without depth it stays.")
    weights: float = Field(0.05, ge=0, description="Of the morph targets.")
    base_color: float = Field(0.02, ge=0, description="Of texels.")
    normal: float = Field(0.005, ge=0, description="Of texels.")
    specular: float = Field(0.005, ge=0, description="Of roughness and metalness, texels.")
    light: float = Field(0.01, ge=0, description="Of the environment's spherical harmonics; 0: grey from everywhere.")


class FaceSettings(Section):
    """What `mi-simplify face` does."""

    model: str = Field(
        min_length=1,
        description="A glTF file with morph targets, or an npz with neutral, quads, uvs, uv_quads, identity, "
        "expression, expression_names and landmarks.",
    )
    portraits: str = Field(
        min_length=1, description="JSON file of images with intrinsics, landmarks, and depth or none."
    )
    landmarks: Annotated[tuple[Triple, ...], BeforeValidator(as_list)] = Field(
        (), description="Of a glTF file: where the landmarks are at weight 0; the nearest vertex is taken."
    )
    identity: int = Field(100, ge=0, description="Of an npz: how many of its modes of identity are fitted.")
    depth: bool = Field(True, description="Whether depth is looked at where the images have it.")
    steps: int = Field(200, ge=0, description="After the landmarks alone.")
    decay: float = Field(0.1, gt=0, le=1, description="What is left of the rates at the end.")
    resolution: int = Field(256, ge=16, le=4096, description="Side of the square film [px].")
    spp: int = Field(2, ge=1, le=64, description="Samples per pixel of a step.")
    texture_size: int = Field(512, ge=1, le=8192, description="Side of the textures [texels].")
    loss: FaceLoss = FaceLoss()
    rates: FaceRates = FaceRates()
    seed: int = Field(0, ge=0, lt=2**31, description="Of sample positions.")


def load_face(path: str | Path) -> FaceSettings:
    """
    Read the settings from YAML; relative paths in it are relative to its folder.

    Raises
    ------
    ConfigError
        One line with the dotted path: unknown key, wrong type, out of range.
    """
    path = Path(path)
    settings = validated(FaceSettings, read_yaml(path))
    folder = path.resolve().parent
    names = {name: str(folder / Path(getattr(settings, name)).expanduser()) for name in ("model", "portraits")}
    return settings.model_copy(update=names)
