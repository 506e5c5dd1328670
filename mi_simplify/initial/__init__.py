"""The first guess: clean up, decimate, unwrap, bake."""

from .bake import Baked as Baked
from .bake import bake as bake
from .cards import cards as cards
from .cards import is_aggregate as is_aggregate
from .cleanup import clean as clean
from .decimate import decimate as decimate
from .guess import first_guess as first_guess
from .guess import quadrics_only as quadrics_only
from .soup import Soup as Soup
from .soup import merge as merge
from .sphere import sphere as sphere
from .unwrap import unwrap as unwrap

__all__ = [
    "Baked", "Soup", "bake", "cards", "clean", "decimate", "first_guess", "is_aggregate", "merge", "quadrics_only",
    "sphere", "unwrap",
]  # fmt: skip
