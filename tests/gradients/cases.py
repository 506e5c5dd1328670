"""
Every case of the gradient table: which scene, through which renderer, under which light, and whether it is promised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from . import scenes
from .batched import Batched
from .finite_difference import Pair, Renderer, compare, mean_over_interval
from .mitsuba_cases import CASES
from .plugin import Plugin, direct_projective
from .scenes import Scene, film_weights, parameters

#: What extra cases look at; the meshes' own cases take every parameter.
_FEW = ("translation x", "translation y", "rotation", "scale", "camera position", "texels base_color")


#: Parameters of a case that ``make slow`` looks at, others in each case; the whole table is a matter of half an hour.
_EACH = 3


@dataclass(frozen=True)
class Case:
    """
    One renderer on one scene.

    Parameters
    ----------
    build : callable
        Makes the renderer from the scene.
    only : tuple of str, optional
        Names of the parameters looked at, all without it.
    rival : bool
        `direct_projective` renders the same image, so that its gradient may be compared.
    effort : float
        Share of the usual samples a round: several layers take as many times longer, and have far less noise than asked
        for.
    """

    title: str
    scene: str
    build: Callable[[Scene], Renderer]
    only: tuple[str, ...] | None = None
    rival: bool = False
    effort: float = 1.0

    def measure(self, turn: int | None = None, **options) -> list[Pair]:
        """
        Compare the case's parameters, or with ``turn`` only those whose turn it is; ``options`` go to :func:`compare`.
        """
        scene = scenes.scene(self.scene)
        renderer = self.build(scene)
        adjoint = film_weights(scene, renderer.shape[0])
        wanted = [p for p in parameters(scene, renderer.start) if self.only is None or p.name in self.only]
        if turn is not None:
            wanted = [wanted[(_EACH * turn + k) % len(wanted)] for k in range(min(_EACH, len(wanted)))]
        effort = self.effort * scene.effort
        counts = {"spp": int(512 * effort), "gradient_spp": int(64 * effort)}
        pairs = compare(renderer, self.title, wanted, adjoint, **(counts | options))
        if self.rival:
            self._measure_rival(renderer, pairs, adjoint)
        return pairs

    def _measure_rival(self, renderer: Plugin, pairs: list[Pair], adjoint: np.ndarray, rounds: int = 2) -> None:
        colour = adjoint * np.float32([1, 1, 1, 0])  # it has no derivative of alpha
        integrator = direct_projective(64, 64)
        for pair in pairs:
            attach = tuple(pair.parameter.direction)

            def gradient(state, seed, attach=attach):
                return renderer.gradient(colour, 0, seed, attach, state, integrator)

            pair.rival.values = [
                mean_over_interval(gradient, renderer.start, pair.parameter, 200_000 + k) for k in range(rounds)
            ]


@dataclass(frozen=True)
class MitsubaCase:
    """
    One scene of Mitsuba's own parts, see :mod:`.mitsuba_cases`; rendered without shadows where its name has none, which
    Mitsuba's integrators cannot, so that there is no rival.
    """

    title: str
    rival: bool = False

    def measure(self, turn: int | None = None, **options) -> list[Pair]:
        """
        Compare the case's parameters, all of which always have their turn; ``options`` go to :func:`compare`.
        """
        scene = CASES[self.title]()
        counts = {"spp": 256, "gradient_spp": 32}
        return compare(scene, self.title, scene.parameters(), scene.weights(), **(counts | options))


def vertex_noise(gradient: Callable[[int], np.ndarray], rounds: int = 8) -> float:
    """
    Standard deviation of a vertex gradient over its length: sqrt(total variance) / |mean|.

    Parameters
    ----------
    gradient : callable
        Of a seed; shape (P, 3).
    """
    samples = np.stack([gradient(300_000 + k) for k in range(rounds)]).astype(np.float64)
    return float(np.sqrt(samples.var(axis=0, ddof=1).sum()) / np.linalg.norm(samples.mean(axis=0)))


def _sky() -> dict:
    y, x = np.meshgrid(np.linspace(0, np.pi, 16), np.linspace(0, 2 * np.pi, 32), indexing="ij")
    level = 0.5 + 0.4 * np.sin(x + 1) * np.sin(y) + 0.1 * np.cos(y)
    rgb = np.stack([level, 0.8 * level, 1.2 - level], axis=2).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(rgb)}


def _lamp() -> dict:
    # A mesh, behind and above the camera: no ray meets it.
    place = mi.ScalarTransform4f().translate([1.5, 3, -4]).scale(0.5)
    radiance = {"type": "rgb", "value": [12.0, 11.0, 10.0]}
    return {"type": "cube", "to_world": place, "emitter": {"type": "area", "radiance": radiance}}


def _sun() -> dict:
    return {
        "type": "directional",
        "direction": [-0.4, -0.8, 1],
        "irradiance": {"type": "rgb", "value": [2.0, 1.8, 1.5]},
    }


def _batched() -> list[Case]:
    return [Case(name, name, Batched) for name in scenes.NAMES]


def _plugin() -> list[Case]:
    return [Case(name, name, Plugin, rival=True) for name in scenes.NAMES]


def _variations() -> list[Case]:
    def case(title: str, scene: str, only=_FEW, emitter=lambda: None, effort=1.0, **options) -> Case:
        build = lambda s: Plugin(s, headlight=False, emitter=emitter(), **options)  # noqa: E731
        return Case(title, scene, build, only, effort=effort)

    layers = ("translation x", "translation y", "scale", "camera position", "texels opacity")
    return [
        case("two objects, Gaussian filter", "two objects", rfilter="gaussian"),
        case("cut by the border, Gaussian filter", "cut by the border", rfilter="gaussian"),
        case("small on a wide film", "small on a wide film"),
        case("two objects, environment map", "two objects", emitter=_sky, matte=True),
        case("hides itself, area light", "hides itself", emitter=_lamp, matte=True),
        case("smooth, directional light", "smooth, seams", emitter=_sun),
        case("smooth, Mitsuba's diffuse", "smooth, seams", _FEW[:5], bsdf={"type": "diffuse"}),
        case("two objects, 1 layer", "two objects", layers, effort=1 / 4, layers=1),
        case("two objects, 2 layers", "two objects", layers, effort=1 / 4, layers=2),
        case("open sheet, 8 layers", "open sheet", layers, effort=1 / 4, layers=8),
        case("hides itself, 8 layers", "hides itself", layers, effort=1 / 4, layers=8),
    ]


def _mitsuba() -> list[MitsubaCase]:
    return [MitsubaCase(name) for name in CASES]


def _close_up() -> list[Case]:
    only = ("one vertex",)
    return [
        Case("20k triangles, close-up", "20k triangles, close-up", Batched, only),
        Case("20k triangles, close-up", "20k triangles, close-up", Plugin, only, rival=True),
    ]


def _outside() -> list[Case]:
    geometry = ("translation x", "translation y", "rotation", "scale", "camera position")

    def case(title: str, scene: str, **options) -> Case:
        return Case(title, scene, lambda s: Plugin(s, **options), geometry)

    return [
        case("objects that cut through each other", "objects that cut through each other"),
        case("two smooth objects, moving shadows", "two objects", headlight=False, shadows=True),
    ]


#: Sections of the table. The last one is outside of what is promised, measured all the same.
SECTIONS: dict[str, Callable[[], Sequence[Case | MitsubaCase]]] = {
    "Batched renderer": _batched,
    "Plugin": _plugin,
    "Plugin: filters, lights, layers": _variations,
    "Plugin: Mitsuba's own BSDFs, sensors, films and lights": _mitsuba,
    "One vertex among 20,000 triangles": _close_up,
    "Outside of the promise": _outside,
}
PROMISED = tuple(SECTIONS)[:-1]
