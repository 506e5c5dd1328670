"""Closed-form mip levels: means, and the spread of normals as roughness."""

import numpy as np
import pytest

from mi_simplify.model.mips import filtered_levels, n_levels


def material(n, normal, roughness=0.3):
    base = np.full((n, n, 4), 0.5, np.float32)
    specular = np.zeros((n, n, 3), np.float32)
    specular[..., 1] = roughness
    return base, specular, np.broadcast_to(np.float32(normal), (n, n, 3))


def test_a_plain_material_stays_what_it_is():
    levels = filtered_levels(*material(16, [0.6, 0, 0.8]))
    assert len(levels) == 4 == n_levels(16, 16) - 1
    for k, level in enumerate(levels):
        assert level["base_color"].shape == (8 >> k, 8 >> k, 4)
        assert np.allclose(level["base_color"], 0.5) and np.allclose(level["normal"], [0.6, 0, 0.8], atol=1e-6)
        assert np.allclose(level["specular"], [0, 0.3, 0], atol=1e-6)


def test_spread_normals_become_rough():
    """Facets that tilt by ±t along both axes have slopes of variance tan² t; the coarse lobe is that much wider."""
    base, specular, _ = material(8, [0, 0, 1], 0.2)
    t = 0.1
    tilt = np.where(np.indices((8, 8)) % 2, t, -t).transpose(1, 2, 0)
    normal = np.concatenate([tilt, np.ones((8, 8, 1))], axis=2)
    levels = filtered_levels(base, specular, normal.astype(np.float32))
    expected = (0.2**4 + 2 * t**2) ** 0.25  # α² and α = roughness²
    for level in levels:
        assert np.allclose(level["normal"], [0, 0, 1], atol=1e-6)
        assert level["specular"][..., 1] == pytest.approx(expected, rel=0.02)


def test_colours_are_weighted_by_opacity():
    base, specular, normal = material(2, [0, 0, 1])
    base[0, 0], base[0, 1] = [1, 0, 0, 1], [0, 1, 0, 0]
    base[1] = [0, 0, 1, 0]
    (level,) = filtered_levels(base, specular, normal)
    assert np.allclose(level["base_color"][0, 0], [1, 0, 0, 0.25])
