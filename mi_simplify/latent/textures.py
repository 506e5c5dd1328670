"""
The latent textures in one packed image, so that a lookup is a few wide gathers and a gradient a few wide scatters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ..machine.upload import upload
from ..model.mips import filtered_levels, n_levels
from .footprint import BLOCK, Footprint

#: Order of the channels in memory; the last four are there only where opacity or gamma is used.
CHANNELS = ("red", "green", "blue", "roughness", "metallic", "nx", "ny", "nz", "opacity", "gamma", "free0", "free1")


@dataclass
class Texels:
    """
    Material at some surface points: linear base colour, scalars in [0, 1], tangent-space normal (not unit).
    """

    base_color: mi.Color3f
    roughness: mi.Float
    metallic: mi.Float
    normal: mi.Vector3f
    opacity: mi.Float
    gamma: mi.Float


#: Texels are stored in square tiles of this side: what one lookup reads lies close together, and so do its neighbours'.
TILE = 8


def needs_extended(base_color: np.ndarray, specular: np.ndarray) -> bool:
    """
    Whether images have any opacity or γ, which only extended textures keep.
    """
    return bool((base_color[..., 3] < 1).any() or specular[..., 0].any())


@dataclass(init=False, eq=False)
class Textures:
    """
    Packed base colour, roughness, metalness, normal and, on request, opacity and γ, in one level or a chain of them.

    Parameters
    ----------
    base_color : ndarray, shape (H, W, 4)
    specular : ndarray, shape (H, W, 3)
        (gamma, roughness, metallic).
    normal : ndarray, shape (H, W, 3)
    extended : bool
        Keep opacity and γ; else they are 1 and 0.
    mips : {'none', 'derived', 'custom'}
        Coarser levels: none; each the mean of the next finer one (2x2 box), as viewers make them; or parameters of
        their own.
    coarser : sequence of dict
        Images of the coarser levels, as :meth:`images` gives them, to start custom ones from; without it those of
        ``mips.filtered_levels``.
    cells : ndarray, shape (M, 4), optional
        Rectangles (left, top, width, height) of the images that repeat each by itself; none: the images as a whole.

    Raises
    ------
    ValueError
        Mip levels of a texture whose sides are not powers of two, or of one in cells.
    """

    data: mi.Float
    height: int
    width: int
    n_channels: int
    n_levels: int
    offsets: mi.UInt32
    mips: str
    steepness: mi.Float | None
    """What is stored as opacity is cut at ``cutoff`` with this slope, width 1; None: it is the opacity."""
    cutoff: float
    cells: mi.UInt32 | None
    """Left, top, width and height of every cell, flat."""

    def __init__(
        self,
        base_color: np.ndarray,
        specular: np.ndarray,
        normal: np.ndarray,
        extended: bool = False,
        mips: str = "none",
        coarser: Sequence[dict[str, np.ndarray]] = (),
        cells: np.ndarray | None = None,
    ):
        if cells is not None and mips != "none":
            raise ValueError("textures in cells have no mip levels")
        self.cells = None if cells is None else upload(mi.UInt32, np.ravel(cells))
        self.height, self.width = base_color.shape[:2]
        self.n_channels, self.mips, self.steepness = 12 if extended else 8, mips, None
        self.cutoff = 0.5
        self.n_levels = 1 if mips == "none" else n_levels(self.height, self.width)
        sizes = [self.size(k) for k in range(self.n_levels)]
        first = np.cumsum([0] + [self.room(k) for k in range(self.n_levels)])
        self.n_stored, self.offsets = int(first[-1]), upload(mi.UInt32, first[:-1])
        levels = [dict(base_color=base_color, specular=specular, normal=normal)]
        if mips == "custom":
            levels += list(coarser) or filtered_levels(*levels[0].values())
        packed = np.zeros((self.n_stored, self.n_channels), np.float32)
        for level, images in enumerate(levels):
            row, column = np.indices(sizes[level])
            packed[first[level] + self.place(row, column, sizes[level][1])] = self._packed(**images)
        self.data = upload(mi.Float, packed.ravel())
        self._room = 0
        self.refresh()

    def _packed(self, base_color: np.ndarray, specular: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """The images of a level in the order of the channels, shape (H, W, channels)."""
        planes = [base_color[..., :3], specular[..., 1:3], normal]
        if self.extended:
            planes += [base_color[..., 3:4], specular[..., :1], np.zeros((*base_color.shape[:2], 2))]
        return np.concatenate(planes, axis=2)

    def size(self, level: int) -> tuple[int, int]:
        """
        Height and width of a level [texels].
        """
        return max(self.height >> level, 1), max(self.width >> level, 1)

    def room(self, level: int) -> int:
        """
        Texels that are stored for a level: those of whole tiles.
        """
        height, width = self.size(level)
        return -(-width // TILE) * -(-height // TILE) * TILE**2

    def place(self, row, column, width=None):
        """
        Where a texel of a level of that width, by default the finest one's, is stored, counted in texels from the
        level's first; for NumPy and Dr.Jit integers.
        """
        width = self.width if width is None else width
        tile = (row // TILE) * ((width + (TILE - 1)) // TILE) + column // TILE
        return (tile * TILE + row % TILE) * TILE + column % TILE

    def places(self, level: int) -> mi.UInt32:
        """
        Where all texels of a level are stored, row by row.
        """
        height, width = self.size(level)
        texel = dr.arange(mi.UInt32, height * width)
        row = texel // width
        return self.place(row, texel - row * width, width) + dr.gather(mi.UInt32, self.offsets, level)

    def gradient_room(self, n_blocks: int) -> int:
        """
        Blocks to make room for where a gradient has ``n_blocks``: hardly ever another number than before.

        Every size of what threads add up in private copies is a kernel of its own, compiled for a third of a second.
        """
        if n_blocks > self._room:
            need = n_blocks + n_blocks // 2
            unit = 1 << max(need.bit_length() - 3, 0)
            self._room = min(-(-need // unit) * unit, self.n_stored // BLOCK)
        return self._room

    @property
    def extended(self) -> bool:
        """Whether opacity and γ are there."""
        return self.n_channels == 12

    def images(self, level: int = 0) -> dict[str, np.ndarray]:
        """
        ``base_color`` (H, W, 4), ``specular`` (H, W, 3) and unit ``normal`` (H, W, 3) of a level in NumPy.
        """
        place = self.places(level).numpy().reshape(self.size(level))
        data = self.data.numpy().reshape(-1, self.n_channels)[place]
        one, zero = np.ones_like(data[..., :1]), np.zeros_like(data[..., :1])
        opacity, gamma = (data[..., 8:9], data[..., 9:10]) if self.extended else (one, zero)
        normal = data[..., 5:8]
        normal = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-8)
        return dict(
            base_color=np.concatenate([data[..., :3], opacity], axis=2),
            specular=np.concatenate([gamma, data[..., 3:5]], axis=2),
            normal=normal,
        )

    def refresh(self) -> None:
        """
        Make derived levels anew from the finest one.
        """
        if self.mips != "derived":
            return
        n = self.n_channels
        for level in range(1, self.n_levels):
            finer, target = self.places(level - 1), self.places(level)
            (fine_height, fine_width), width = self.size(level - 1), self.size(level)[1]
            texel = dr.arange(mi.UInt32, dr.width(target))
            row = texel // width
            values = mi.ArrayXf(0)
            for j, i in ((0, 0), (0, 1), (1, 0), (1, 1)):  # a level one texel wide has no second row or column
                r = dr.minimum(2 * row + j, fine_height - 1)
                c = dr.minimum(2 * (texel - row * width) + i, fine_width - 1)
                place = dr.gather(mi.UInt32, finer, r * fine_width + c)
                values = values + 0.25 * dr.gather(mi.ArrayXf, self.data, place, shape=(n, dr.width(place)))
            dr.eval(values)
            dr.scatter(self.data, values, target)
            dr.eval(self.data)

    def level(self, length: mi.Float) -> mi.Float:
        """
        The level whose texels are as long as a length in UV space; differentiable.
        """
        texels = length * (self.width * self.height) ** 0.5
        return dr.clip(dr.log2(dr.maximum(texels, 1e-6)), 0, self.n_levels - 1)

    def footprint(
        self, u: mi.Float, v: mi.Float, level: mi.Float | None = None, cell: mi.UInt32 | None = None
    ) -> Footprint:
        """
        The texels around a UV and their bilinear weights, texel centres at ``(k + .5)/N``, repeating.

        Parameters
        ----------
        level : mi.Float, optional
            Read between two levels, 0 the finest; needed where there are several.
        cell : mi.UInt32, optional
            Which of the cells; looked at only where there are some.
        """
        if self.n_levels == 1:
            return self._around(u, v, cell=cell)
        if level is None:
            raise ValueError("a texture with mip levels is read at a level")
        fine = mi.UInt32(dr.minimum(dr.floor(dr.detach(level)), self.n_levels - 2))
        footprint = self._around(u, v, fine)
        footprint.coarser, footprint.blend = self._around(u, v, fine + 1), level - mi.Float(fine)
        return footprint

    def _around(
        self, u: mi.Float, v: mi.Float, level: mi.UInt32 | None = None, cell: mi.UInt32 | None = None
    ) -> Footprint:
        """Texels of one level and cell, the same for all or one of each lane's own."""
        width, height, first, left, top = self.width, self.height, 0, 0, 0
        if self.cells is not None:
            assert cell is not None, "textures in cells are read in one"
            rectangle = dr.gather(mi.Vector4u, self.cells, cell)
            left, top, width, height = rectangle.x, rectangle.y, mi.Int32(rectangle.z), mi.Int32(rectangle.w)
        if level is not None:
            width, height = (mi.Int32(dr.maximum(mi.UInt32(n) >> level, 1)) for n in (width, height))
            first = dr.gather(mi.UInt32, self.offsets, level)
        scale = (lambda n: n) if isinstance(width, int) else mi.Float
        x, y = dr.fma(u, scale(width), -0.5), dr.fma(v, scale(height), -0.5)
        x0, y0 = dr.floor(dr.detach(x)), dr.floor(dr.detach(y))
        ix, iy = self._wrap(mi.Int32(x0), width), self._wrap(mi.Int32(y0), height)
        jx = dr.select(ix + 1 < width, ix + 1, 0)
        jy = dr.select(iy + 1 < height, iy + 1, 0)
        of = None if level is None else mi.UInt32(width)
        index = [self.place(mi.UInt32(r) + top, mi.UInt32(c) + left, of) + first for r in (iy, jy) for c in (ix, jx)]
        return Footprint(index, x - x0, y - y0)

    def _wrap(self, i: mi.Int32, n: int | mi.Int32) -> mi.Int32:
        if not isinstance(n, int) and self.cells is None:
            return i & (n - 1)  # of mip levels, whose sides are powers of two
        per_side = 1 / n if isinstance(n, int) else dr.rcp(mi.Float(n))
        i = i - n * mi.Int32(dr.floor(mi.Float(i) * per_side))
        # The quotient of a multiple of n may come out one off.
        return dr.select(i < 0, i + n, dr.select(i >= n, i - n, i))

    def lookup(self, footprint: Footprint) -> mi.ArrayXf:
        """
        Bilinear or trilinear texel values, shape (channels, N); differentiable by UV and level, never by the texels,
        for which there is :class:`.texel_gradient.TexelGradient`.
        """
        data = dr.detach(self.data)
        shape = (self.n_channels, dr.width(footprint.index[0]))
        a, b, c, d = (dr.gather(mi.ArrayXf, data, i, shape=shape) for i in footprint.index)
        value = dr.lerp(dr.lerp(a, b, footprint.fx), dr.lerp(c, d, footprint.fx), footprint.fy)
        if footprint.coarser is None:
            return value
        return dr.lerp(value, self.lookup(footprint.coarser), footprint.blend)

    def unpack(self, value: mi.ArrayXf) -> Texels:
        """
        Name the channels of a lookup.
        """
        extended = self.extended
        return Texels(
            base_color=mi.Color3f(value[0], value[1], value[2]),
            roughness=value[3],
            metallic=value[4],
            normal=mi.Vector3f(value[5], value[6], value[7]),
            opacity=self._cut(value[8]) if extended else mi.Float(1),
            gamma=value[9] if extended else mi.Float(0),
        )

    def opacity(self, u: mi.Float, v: mi.Float, cell: mi.UInt32 | None, active: mi.Bool | bool = True) -> mi.Float:
        """
        That of the finest level alone, as :meth:`unpack` has it; detached.
        """
        if not self.extended:
            return mi.Float(1)
        data, footprint = dr.detach(self.data), self._around(u, v, cell=cell)
        a, b, c, d = (dr.gather(mi.Float, data, i * self.n_channels + 8, active) for i in footprint.index)
        return self._cut(dr.lerp(dr.lerp(a, b, footprint.fx), dr.lerp(c, d, footprint.fx), footprint.fy))

    def _cut(self, opacity: mi.Float) -> mi.Float:
        """Opacity between a ramp and a step, see ``steepness``."""
        if self.steepness is None:
            return opacity
        return dr.clip(dr.fma(opacity - self.cutoff, self.steepness, 0.5), 0, 1)
