"""Small latent models, and their pictures by the batched renderer."""

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import zoom

from mi_simplify.integrators.deferred import DeferredRenderer
from mi_simplify.latent.latent import Latent
from mi_simplify.machine.upload import upload
from mi_simplify.model.model import Displacement, Model
from support.tiny_meshes import charted_sphere


def textured_sphere() -> Model:
    """A sphere with charts of every kind, mirrored ones too, and smooth random textures that are not square."""
    rng = np.random.default_rng(3)
    smooth = lambda c, low, high: zoom(rng.uniform(low, high, (6, 8, c)), (16, 8, 1), order=1)  # noqa: E731
    normal = np.concatenate([smooth(2, -0.5, 0.5), smooth(1, 1, 1)], axis=2)
    color = np.concatenate([smooth(3, 0.1, 0.9), smooth(1, 1, 1)], axis=2)
    specular = np.concatenate([smooth(1, 0, 0), smooth(1, 0.4, 0.9), smooth(1, 0, 1)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return Model(charted_sphere(8), *(x.astype(np.float32) for x in (color, specular, normal)))


def random_sphere(seed=0, size=8, **kwargs):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(size, size, 3)) * 0.2 + [0, 0, 1]
    normal = (normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32)
    base, specular = (rng.random((size, size, c)).astype(np.float32) for c in (4, 3))
    return Model(charted_sphere(2, noise=0.05), base, specular, normal, **kwargs)


def displaced_sphere(n=2, size=32, subdivisions=2, seed=0, amplitude=0.05) -> Model:
    rng = np.random.default_rng(seed)
    base, specular = (rng.uniform(0.3, 0.7, (16, 16, c)).astype(np.float32) for c in (4, 3))
    base[..., 3], specular[..., ::2] = 1, 0
    y, x = np.indices((size, size)) / size * 2 * np.pi
    height = np.float32(amplitude * np.sin(2 * x + 0.3) * np.cos(3 * y))
    normal = np.tile(np.float32([0, 0, 1]), (16, 16, 1))
    return Model(charted_sphere(n, 0.02), base, specular, normal, displacement=Displacement(height, subdivisions))


def rendered(model: Model, views):
    latent = Latent(model)
    positions = upload(mi.Float, latent.topology.mesh.positions.ravel())
    renderer = DeferredRenderer(latent.topology)
    renderer.move(positions)
    return renderer.render(latent.evaluate(positions), latent.textures, views, spp=16, seed=dr.opaque(mi.UInt32, 1))
