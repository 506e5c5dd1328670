"""
Mitsuba's BSDFs as metallic-roughness materials, near enough to start a fit from.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...model.asset import Material
from ..images import unit_normals
from ..mapping import Mapping
from ..resources import Resources
from .field import Field, image
from .file import Node, SceneFile
from .look import DEFAULT, WHITE, Look, texture_transform

#: Textures that are looked up by position or vertex, not by texture coordinates.
_AT_POINTS = ("mesh_attribute", "volume")


class Materials:
    """
    Materials of a scene's BSDFs, each made once.

    Parameters
    ----------
    file : SceneFile
    resources : Resources
        Notes what is only approximated.
    look_of : callable
        The look of a BSDF, given these materials for what is nested in it: :func:`.looks.look_of`.
    """

    def __init__(self, file: SceneFile, resources: Resources, look_of: Callable[[Node, Materials], Look]):
        self.file, self.resources, self._look_of = file, resources, look_of
        self._made: dict[int, tuple[Look, Material, Mapping]] = {}

    def of(self, bsdf: Node | None) -> tuple[Look, Material, Mapping]:
        """
        Look, material and texture coordinates of a BSDF; None stands for Mitsuba's default.
        """
        index = -1 if bsdf is None else bsdf.index
        if index not in self._made:
            look = self.look(bsdf)
            name = "default" if bsdf is None else bsdf.id or bsdf.plugin
            self._made[index] = (look, *self._material(name, look))
        return self._made[index]

    def look(self, bsdf: Node | None) -> Look:
        """
        The look of a BSDF; None stands for Mitsuba's default.
        """
        if bsdf is None:
            return DEFAULT
        return self._look_of(bsdf, self)

    def note(self, bsdf: Node, text: str) -> None:
        """
        Note that a BSDF is only approximated.
        """
        self.resources.note(f"{bsdf} {text}")

    def field(self, node: Node, name: str, default: Field) -> Field:
        """
        Parameter ``name`` of a BSDF, of as many channels as its default has.
        """
        n_channels = default.at(np.zeros((1, 2))).shape[1]
        texture = node.child(name)
        if texture is not None:
            if texture.plugin in _AT_POINTS:
                self.note(node, f"takes its {name} from '{texture.plugin}', which no texture can hold")
                return default
            return Field.texture(self.file.make(texture), n_channels, texture_transform(texture))
        params = mi.traverse(self.file.make(node))
        for key in (f"{name}.value", name):
            if key in params:
                value = np.ravel(params[key]).astype(np.float32)
                value = np.broadcast_to(value if n_channels == len(value) else value.mean(), n_channels)
                return Field.constant(*value)
        return default

    def color(self, node: Node, name: str, default: float = 0.5) -> Field:
        """
        A parameter of three channels.
        """
        return self.field(node, name, Field.constant(default, default, default))

    def scalar(self, node: Node, name: str, default: float) -> Field:
        """
        A parameter of one channel.
        """
        return self.field(node, name, Field.constant(default))

    def base(self, node: Node, name: str, **look: Any) -> Look:
        """
        A look whose colour is parameter ``name``.
        """
        texture = node.child(name)
        if texture is not None and texture.plugin in _AT_POINTS:
            return Look(color=WHITE, at_vertices=True, **look)
        return Look(color=self.color(node, name), **look)

    def nested(self, node: Node) -> Look:
        """
        The look of the first BSDF inside another.
        """
        inner = node.of_kind("BSDF")
        return self.look(inner[0] if inner else None)

    def _material(self, name: str, look: Look) -> tuple[Material, Mapping]:
        opacity = Field.constant(1.0) if look.opacity is None else look.opacity
        groups = [[look.color, opacity], [look.gamma, look.roughness, look.metallic]]
        groups += [] if look.normal is None else [[look.normal]]
        varying = [f for group in groups for f in group if not f.is_constant]
        to_uv = varying[0].to_uv if varying else np.eye(2, 3)
        mapping = Mapping(transform=to_uv)
        if any(not mapping.same_place(Mapping(transform=f.to_uv)) for f in varying):
            self.resources.note(f"the textures of '{name}' have several UV transforms; all are taken to repeat as one")
        base, specular, *normal = (np.clip(image(group, to_uv), -1, 1) for group in groups)
        base, specular = np.maximum(base, 0), np.maximum(specular, 0)
        alpha = base[..., 3]
        mode = "OPAQUE" if alpha.min() == 1 else "MASK" if look.cutoff > 0 or alpha.max() > alpha.min() else "BLEND"
        if mode == "MASK" and look.cutoff == 0 and not np.isin(alpha, (0, 1)).all():
            mode = "BLEND"
        cutoff = look.cutoff if look.cutoff > 0 else 0.5
        return Material(name, base, specular, unit_normals(normal[0]) if normal else None, mode, cutoff), mapping


def vertex_colors(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f) -> np.ndarray | None:
    """
    Diffuse reflectance at points of a surface, shape (V, 4) with opacity 1, float32; None where the BSDF knows none.
    """
    si.wi = mi.Vector3f(0, 0, 1)
    try:
        value = mi.Color3f(bsdf.eval_diffuse_reflectance(si))
        dr.eval(value)
    except Exception:  # Mitsuba raises RuntimeError, a BSDF in Python whatever it likes
        return None
    rows = np.broadcast_to(value.numpy().T, (dr.width(si), 3))
    return np.concatenate([np.clip(np.nan_to_num(rows), 0, 1), np.ones((len(rows), 1))], 1).astype(np.float32)
