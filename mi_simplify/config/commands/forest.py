"""
A forest: thousands of copies of a detailed plant and of its approximation, rendered side by side.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from ..layers import read_yaml
from ..problems import validated
from ..section import SAMPLE_PREFIX, Section, Triple


class PlantSettings(Section):
    """A plant and what stands for it."""

    original: str = Field(min_length=1, description="Model file or `sample:NAME`.")
    approximation: str = Field(min_length=1, description="Model file in the original's place and units.")


def _as_tuple(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value


class ForestSettings(Section):
    """Where the plants stand, and how the picture is taken."""

    plants: Annotated[tuple[PlantSettings, ...], BeforeValidator(_as_tuple)] = Field(
        min_length=1, description="Species; every copy is one of them at random."
    )
    instances: int = Field(3000, ge=1, le=1_000_000, description="How many copies.")
    side: float = Field(40.0, gt=0, description="Side of the square that they stand on [heights of the tallest plant].")
    least_size: float = Field(0.7, gt=0, le=1, description="Sizes lie between this and 1.")
    seed: int = Field(0, ge=0, lt=2**31, description="Of places, turns, sizes and noise.")
    ground: Triple = Field((0.1, 0.07, 0.04), description="Reflectance of the ground, linear.")
    environment: str | None = Field(None, description="Environment map (EXR or HDR); none: a constant sky.")
    camera: Triple = Field((0.0, 0.12, 0.62), description="Where the camera stands [sides of the square], Y up.")
    target: Triple = Field((0.0, 0.0, 0.0), description="What it looks at [sides of the square].")
    fov: float = Field(40.0, gt=0, lt=180, description="Field of view across [degrees].")
    width: int = Field(640, ge=16, le=8192, description="Of the picture [px].")
    height: int = Field(360, ge=16, le=8192, description="Of the picture [px].")
    spp: int = Field(64, ge=1, le=65536, description="Samples per pixel.")
    max_depth: int = Field(6, ge=2, le=1024, description="Longest light path [edges].")


def load_forest(path: str | Path) -> ForestSettings:
    """
    Read a forest from YAML; relative paths in it are relative to its folder.

    Raises
    ------
    ConfigError
        One line with the dotted path: unknown key, wrong type, out of range.
    """
    path = Path(path)
    forest = validated(ForestSettings, read_yaml(path))
    folder = path.resolve().parent

    def found(name: str) -> str:
        return name if name.startswith(SAMPLE_PREFIX) else str(folder / Path(name).expanduser())

    plants = tuple(
        PlantSettings(original=found(p.original), approximation=found(p.approximation)) for p in forest.plants
    )
    environment = None if forest.environment is None else found(forest.environment)
    return forest.model_copy(update={"plants": plants, "environment": environment})
