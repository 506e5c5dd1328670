"""
The scenes of the gradient tests: meshes, textures, cameras and lights, and the parameters that are differentiated.

A scene's state is a dictionary of NumPy arrays, and a parameter is a direction in it: the derivative of the
image along ``state + s·direction`` at s = 0. Both renderers are driven by the same states and directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mi_simplify.model.mesh import Mesh
from mi_simplify.model.topology import vertex_normals
from mi_simplify.scenes.views import Views, look_at

from . import meshes

State = dict[str, np.ndarray]

#: Texture planes of a state, their channels, and the range that the tests' textures stay in.
PLANES = {
    "base_color": (3, 0.2, 0.8),
    "opacity": (1, 0.4, 1.0),
    "gamma": (1, 0.1, 0.6),
    "roughness": (1, 0.35, 0.7),
    "metallic": (1, 0.2, 0.6),
}


@dataclass(frozen=True)
class Parameter:
    """
    A direction in the state space.

    Parameters
    ----------
    group : str
        Parameters whose derivatives have one unit; their RMS is the yardstick of small ones.
    eps : float
        Half step of the central difference.
    direction : State
        Only the arrays that move.
    """

    name: str
    group: str
    eps: float
    direction: State

    @property
    def moves_edges(self) -> bool:
        """Whether the image changes by jumps that move, too."""
        return self.group in ("geometry", "vertex")


@dataclass(frozen=True)
class Scene:
    """
    Parameters
    ----------
    pieces : tuple of Mesh
        One shape each in a Mitsuba scene, together one mesh for the batched renderer.
    camera : dict
        Arguments of ``look_at``: ``origin target light fov``.
    film : (int, int)
        Width and height [pixels].
    waves : float
        Phase of the adjoint's sinusoids over the longer side of the film [rad], such that no derivative nearly cancels.
    effort : int
        Samples for one that other scenes take.
    step : float
        Half step of finite differences [pixels], about: wide ones are quieter, but the derivative must not bend much.
    """

    name: str
    pieces: tuple[Mesh, ...]
    camera: dict
    film: tuple[int, int]
    n_texels: int = 32
    waves: float = 5.0
    effort: int = 1
    step: float = 0.15

    @property
    def mesh(self) -> Mesh:
        """All pieces as one."""
        return meshes.joined(self.pieces)

    def views(self, headlight: bool = False) -> Views:
        """
        Cameras and lights; with ``headlight`` each light stands at its camera, so that no shadow is seen.
        """
        camera = dict(self.camera)
        if headlight:
            camera["light"] = camera["origin"]
        return look_at(**camera, width=self.film[0], height=self.film[1], irradiance=2.0)

    def state(self, headlight: bool = False, n_views: int | None = None) -> State:
        """
        Where the derivatives are taken.
        """
        rng = np.random.default_rng(7)
        views = self.views(headlight).arrays()
        out = {"positions": self.mesh.positions.copy()}
        for name, (channels, low, high) in PLANES.items():
            out[name] = low + (high - low) * (0.5 + 0.5 * _smooth(rng, self.n_texels, channels))
        tilt = 0.35 * _smooth(rng, self.n_texels, 2)
        out["normal"] = np.concatenate([tilt, np.ones_like(tilt[..., :1])], axis=2)
        out["light_position"] = views["light_position"][:n_views].astype(np.float64)
        out["light_intensity"] = views["light_intensity"][:n_views].astype(np.float64)
        out["camera"] = views["origin"][:n_views].astype(np.float64)
        return out


def _smooth(rng: np.random.Generator, n: int, channels: int) -> np.ndarray:
    """
    Periodic random fields in [-1, 1], shape (n, n, channels).
    """
    y, x = np.meshgrid(*[2 * np.pi * (np.arange(n) + 0.5) / n] * 2, indexing="ij")
    out = np.zeros((n, n, channels))
    for c in range(channels):
        for _ in range(4):
            kx, ky = rng.integers(1, 4, 2) * rng.choice([-1, 1], 2)
            out[..., c] += 0.25 * np.sin(kx * x + ky * y + rng.uniform(0, 2 * np.pi))
    return out


def silhouette_vertex(scene: Scene) -> tuple[int, np.ndarray] | None:
    """
    A position farthest out in some direction of the first view's film, and on it: never hidden; and that direction.

    Of eighteen such the one where the adjoint is strong and no face nearly edge-on, which a finite difference would
    turn over; None where the film cuts all of them off.
    """
    views, mesh, (width, height) = scene.views().arrays(), scene.mesh, scene.film
    local = mesh.positions - views["origin"][0]
    x, y, z = (local @ views[k][0] for k in ("right", "up", "forward"))
    x, y = x / z / views["tan_x"][0], y / z / views["tan_x"][0] * width / height
    strength = np.abs(film_weights(scene, 1)[0].sum(axis=2))
    corners = mesh.positions[mesh.position_faces] - views["origin"][0]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(np.einsum("fi,fi->f", normal, corners[:, 0]))
    facing /= np.linalg.norm(normal, axis=1) * np.linalg.norm(corners[:, 0], axis=1)
    best, found = -1.0, None
    for angle in np.radians(10 + 20 * np.arange(18)):
        p = int(np.argmax(x * np.cos(angle) + y * np.sin(angle)))
        if max(abs(x[p]), abs(y[p])) < 0.85:
            here = strength[int((0.5 - 0.5 * y[p]) * height), int((0.5 + 0.5 * x[p]) * width)]
            here *= facing[(mesh.position_faces == p).any(axis=1)].min()
            if here > best:
                best, found = here, (p, np.cos(angle) * views["right"][0] + np.sin(angle) * views["up"][0])
    return found


def parameters(scene: Scene, state: State) -> list[Parameter]:
    """
    Every parameter of a scene: seven of geometry, six of texels, three of light and camera.
    """
    mesh, p = scene.mesh, state["positions"]
    normals = vertex_normals(p, mesh.position_faces)
    pixel = 2 * np.tan(np.radians(scene.camera.get("fov", 45) / 2)) / scene.film[0] * np.linalg.norm(
        np.asarray(scene.camera["origin"], float)[0] - np.asarray(scene.camera["target"], float)
    )  # fmt: skip
    eps = scene.step * pixel
    out = [
        Parameter(f"translation {'xyz'[k]}", "geometry", eps, {"positions": np.eye(3)[k] + np.zeros_like(p)})
        for k in range(3)
    ]
    axis = np.array([1, 2, 1.5]) / np.linalg.norm([1, 2, 1.5])
    out.append(Parameter("rotation", "geometry", eps, {"positions": np.cross(axis, p)}))
    out.append(Parameter("scale", "geometry", eps, {"positions": p.copy()}))
    out.append(Parameter("along normals", "geometry", eps, {"positions": normals}))
    if len(scene.pieces) > 1:
        first = np.zeros_like(p)
        first[: len(scene.pieces[0].positions)] = [1, 0.5, 0]
        out.append(Parameter("front object alone", "geometry", eps, {"positions": first}))
    found = silhouette_vertex(scene)
    if found is not None and scene.name != "20k triangles":  # too short edges for a difference there, see the close-up
        vertex, outwards = found
        one = np.zeros_like(p)
        one[vertex] = outwards
        out.append(Parameter("one vertex", "vertex", 0.5 * eps, {"positions": one}))
    rng = np.random.default_rng(11)
    for name in (n for n in (*PLANES, "normal") if n in state):
        direction = 0.3 + _smooth(rng, scene.n_texels, state[name].shape[2])
        if name == "normal":
            direction[..., 2] = 0
        out.append(Parameter(f"texels {name}", "texels", 0.02, {name: direction}))
    shift = np.array([0.6, 0.7, -0.4])
    if "light_position" in state:
        out.append(Parameter("light position", "light", 0.02, {"light_position": shift + 0 * state["light_position"]}))
        brighter = np.array([1.0, 0.8, 0.5]) + 0 * state["light_intensity"]
        out.append(Parameter("light intensity", "light", 0.2, {"light_intensity": brighter}))
    step = np.array([0.6, 0.5, 0.6])
    out.append(Parameter("camera position", "geometry", eps, {"camera": step + 0 * state["camera"]}))
    return [p for p in out if set(p.direction) <= set(state)]


def film_weights(scene: Scene, n_views: int) -> np.ndarray:
    """
    The adjoint image: slow sinusoids over the film, shape (B, H, W, 4).

    Their phases are such that neither moving the object in the middle of the film nor growing it cancels out, and the
    first view counts more, so that two views seldom do.
    """
    width, height = scene.film
    y, x = np.meshgrid(np.arange(height) + 0.5 - height / 2, np.arange(width) + 0.5 - width / 2, indexing="ij")
    k = scene.waves / max(width, height)
    out = np.zeros((n_views, height, width, 4))
    for b in range(n_views):
        for c, amplitude in enumerate((1.0, 0.7, 1.2, 0.8)):
            shift, strength = 0.15 * c - 0.3 * b, amplitude / (1 + 2 * b)
            out[b, ..., c] = strength * (np.sin(k * x + 0.6 + shift) + 1.3 * np.sin(-k * y + 0.8 - shift))
    return out.astype(np.float32)


def _camera(*origins, target=(0.03, -0.02, 0.01), light=(1.5, 2.0, -0.5), fov=40.0) -> dict:
    # Off the origin: an edge exactly between two pixels belongs to either, and their weights differ.
    origins = np.array(origins, np.float64)
    return {"origin": origins, "target": target, "light": origins + np.asarray(light), "fov": fov}


def _two() -> tuple[Mesh, ...]:
    front = meshes.placed(meshes.sphere(16, 10), 0.5, (0.1, 0.15, -0.55), (0, 0.5))
    return front, meshes.placed(meshes.sheet(8), 1.0, (0, 0, 0.3), (0.5, 1))


def _overlapping() -> tuple[Mesh, ...]:
    left = meshes.placed(meshes.sphere(16, 10), 0.7, (-0.25, 0, 0), (0, 0.5))
    return left, meshes.placed(meshes.torus(18, 10), 0.8, (0.2, 0.1, -0.2), (0.5, 1))


def _cards() -> tuple[Mesh, ...]:
    """Six tilted quads behind each other that do not cut through each other, some wound away from the camera."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    out = []
    for k in range(6):
        tilt, turn = 0.12 * np.sin(2.1 * k + 1), 0.7 * k
        about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        p = 0.42 * corners @ about_x.T @ about_z.T
        p = p + [0.22 * np.cos(1.9 * k), 0.2 * np.sin(2.6 * k), 0.24 * (k - 2.5)]
        uvs = ((corners[:, :2] * 0.46 + 0.5) + [k % 3, k // 3]) / [3, 2]
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        out.append(Mesh(p, np.arange(4), np.float32(uvs), faces[:, ::-1] if k % 2 else faces))
    return tuple(out)


def _close_up() -> Scene:
    mesh = meshes.sphere(100, 101)
    whole = Scene("", (mesh,), _camera((0, 0.6, -3)), (64, 48))
    target = mesh.positions[silhouette_vertex(whole)[0]]
    return Scene("20k triangles, close-up", (mesh,), _camera((0, 0.6, -3), target=tuple(target), fov=4), (48, 36))


_BUILD: dict[str, Callable[[], Scene]] = {
    "smooth, seams": lambda: Scene(
        "smooth, seams", (meshes.sphere(),), _camera((0, 0.6, -3), (2.4, -0.8, 1.6)), (64, 48), waves=7
    ),
    "cube": lambda: Scene("cube", (meshes.cube(),), _camera((1.3, 1.1, -2.4), (-1, 2.2, 1.8)), (64, 48)),
    "open sheet": lambda: Scene(
        "open sheet", (meshes.sheet(),), _camera((0.6, 0.9, -2.8), (2.5, 0.4, 1.4)), (64, 48), waves=6, effort=2
    ),
    "thin tube": lambda: Scene(
        "thin tube",
        (meshes.tube(),),
        _camera((0.3, 0.2, -3), (2.2, 1, 1.9), fov=20),
        (32, 80),
        waves=40,
        effort=2,
        step=0.05,
    ),
    "two objects": lambda: Scene(
        "two objects", _two(), _camera((0.3, 0.5, -3), (1.6, 0.3, -2.6)), (64, 48), waves=10, effort=2
    ),
    "three faces an edge": lambda: Scene(
        "three faces an edge", (meshes.fin(),), _camera((0.8, 1.2, -2.8), (-2.5, 0.4, 1.4)), (64, 48), waves=7
    ),
    "cut by the border": lambda: Scene(
        "cut by the border",
        (meshes.sphere(),),
        _camera((0.3, 0.5, -2.2), (2, 0.2, 0.9), target=(0.5, 0.2, 0.1), fov=35),
        (56, 40),
        waves=6,
    ),
    "hides itself": lambda: Scene(
        "hides itself", (meshes.torus(),), _camera((0.2, 0.8, -3), (2.6, 1.1, 1)), (64, 48), waves=10
    ),
    "20k triangles": lambda: Scene(
        "20k triangles", (meshes.sphere(100, 101),), _camera((0, 0.6, -3), (2.4, -0.8, 1.6)), (64, 48), waves=10
    ),
    "small on a wide film": lambda: Scene(
        "small on a wide film",
        (meshes.torus(),),
        _camera((0.2, 0.8, -3), (2.6, 1.1, 1), fov=90),
        (120, 36),
        waves=30,
        effort=2,
        step=0.1,
    ),
    "20k triangles, close-up": _close_up,
    "cards": lambda: Scene("cards", _cards(), _camera((0.3, 0.4, -3), (1.4, 0.3, 2.7)), (64, 48), waves=6, effort=2),
    "objects that cut through each other": lambda: Scene(
        "objects that cut through each other", _overlapping(), _camera((0.3, 0.5, -3), (1.6, 0.3, -2.6)), (64, 48)
    ),
}

#: The meshes that every renderer is tried on.
NAMES = tuple(_BUILD)[:9]


def scene(name: str) -> Scene:
    """
    A scene by its name, such as one of :data:`NAMES`.
    """
    return _BUILD[name]()
