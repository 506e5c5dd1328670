"""
Precomputed transfer of something that deforms: what is baked, which network learns it, and how long.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from ..layers import read_yaml
from ..problems import validated
from ..section import SAMPLE_PREFIX, Section

#: Sources that are made, not read.
MADE = ("cloth",)


class BakeSettings(Section):
    """The frames, their geometry images, and the rays."""

    size: int = Field(64, ge=8, le=1024, description="Side of the geometry images [px].")
    frames: int = Field(500, ge=10, le=100_000, description="Poses; of every hundred the last ten are held out.")
    directions: int = Field(256, ge=1, le=65536, description="Rays of a vertex.")
    order: int = Field(3, ge=0, le=3, description="Highest band of the spherical harmonics.")
    bounces: int = Field(0, ge=0, le=2, description="Diffuse interreflections.")
    albedo: float = Field(0.8, ge=0, le=1, description="Diffuse reflectance.")
    close_holes: bool = Field(False, description="Close all borders but the longest.")
    part: str | None = Field(None, description="The part of a model that has several.")
    vertices: int | None = Field(None, ge=3, description="First vertices of a face's file to keep.")
    seed: int = Field(0, ge=0, lt=2**31, description="Of cloth and expressions.")


class TrainSettings(Section):
    """The network and its training."""

    model: Literal["small", "paper"] = Field("small", description="`paper` has 13 million parameters and wants a GPU.")
    epochs: int = Field(400, ge=1, description="At most.")
    minutes: float = Field(25.0, gt=0, description="At most.")
    seed: int = Field(0, ge=0, lt=2**31, description="Of weights and order.")


class TransferSettings(Section):
    """What `mi-simplify transfer run` does."""

    source: str = Field(
        min_length=1, description="`cloth`, `sample:NAME`, a model file, a folder of frames, or an npz of blend shapes."
    )
    bake: BakeSettings = BakeSettings()
    train: TrainSettings = TrainSettings()
    shown: int = Field(20, ge=1, le=200, description="Held-out frames in the report.")


def load_transfer(path: str | Path) -> TransferSettings:
    """
    Read the settings from YAML; a relative path in it is relative to its folder.

    Raises
    ------
    ConfigError
        One line with the dotted path: unknown key, wrong type, out of range.
    """
    path = Path(path)
    settings = validated(TransferSettings, read_yaml(path))
    source = settings.source
    if source not in MADE and not source.startswith(SAMPLE_PREFIX):
        source = str(path.resolve().parent / Path(source).expanduser())
    return settings.model_copy(update={"source": source})
