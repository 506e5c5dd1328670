"""
The mesh operations that there are; to import this makes them known.
"""

from __future__ import annotations

from ..errors import MeshError
from ..model.model import Model
from .displacement import Displaced
from .morphing import Morphing as Morphing
from .operation import MeshOperation, register_operation
from .placing import Placed as Placed
from .skinning import Skinning
from .vertex_sets import Blended


def _skinned(model: Model) -> MeshOperation:
    if model.displacement is not None or model.vertex_sets is not None:
        raise MeshError(
            "a character is neither displaced nor has vertex sets: leave out `initial.subdivisions` and those"
        )
    assert model.skin is not None
    return Skinning(model, model.skin)


register_operation("vertex_sets", lambda model: model.vertex_sets is not None, Blended)
register_operation("displacement", lambda model: model.displacement is not None, Displaced)
register_operation("skinning", lambda model: model.skin is not None, _skinned)
