"""
Light that comes from everywhere, in the latent model: one colour that adds to what the point lights do.

Its radiance on a surface is ``ambient · kd (1 - metallic)``, whatever the view (Hasselgren et al. 2021, Sect. 4.5: "an
ambient material term"). It can be optimised together with the model, and written into the files as emission.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi

from .textures import Texels


def ambient_radiance(ambient: Sequence[mi.Color3f], texels: Texels, n: mi.Vector3f, wi: mi.Vector3f) -> mi.Color3f:
    """
    What a surface shows of the ambient light, without regard to its opacity; differentiable in everything.

    Parameters
    ----------
    ambient : sequence of mi.Color3f
        One coefficient.
    texels : Texels
    n, wi : mi.Vector3f
        Unit shading normal, and direction to the viewer.
    """
    (colour,) = ambient
    return colour * texels.base_color * (1 - texels.metallic)
