"""The pool of reference views: its ring, its renewal, what decides it."""

import numpy as np
import pytest
from support.counting import Counting, draw

from mi_simplify.fitting.pool import ViewPool
from mi_simplify.scenes.references.reference import CallableReference


def pool(capacity=5, seed=0, reference=None, **kwargs):
    return ViewPool(reference or Counting(), draw, capacity, np.random.default_rng(seed), **kwargs)


def held(p):
    """Which images the pool holds."""
    return sorted(int(i.flat[0]) for i in p._images)


def batch(p, n):
    views, images, residuals = p.batch(n)
    shape = (n, p.resolution, p.resolution, 4)
    return views.arrays(), images.numpy().T.reshape(shape), residuals.numpy().T


def test_new_views_take_the_place_of_the_oldest():
    p = pool(capacity=5)
    p.grow(3, 4)
    assert held(p) == [1, 2, 3] and len(p) == 3
    p.grow(4, 4)
    assert held(p) == [3, 4, 5, 6, 7] and len(p) == 5
    p.grow(1, 4)
    p.grow(1, 4)
    assert held(p) == [5, 6, 7, 8, 9]
    p.grow(12, 4)  # more than fit
    assert held(p) == [17, 18, 19, 20, 21] and p.n_rendered == 21
    p.grow(0, 4)
    assert held(p) == [17, 18, 19, 20, 21]


def test_batches_hold_different_views_with_their_own_images():
    p = pool(capacity=6)
    p.grow(6, 4)
    seen = set()
    for _ in range(20):
        arrays, images, residuals = batch(p, 3)
        numbers = images[:, 0, 0, 0].astype(int)
        assert len(set(numbers)) == 3 and np.all(residuals == 0)
        assert np.allclose(images[:, 2, 1, 1:], arrays["origin"], rtol=2e-3)  # kept in half precision
        assert np.all(images[..., 0] == numbers[:, None, None])
        seen |= set(numbers)
    assert seen == {1, 2, 3, 4, 5, 6}
    arrays, images, _ = batch(p, 8)  # more than it holds: some of them twice
    assert len(arrays["origin"]) == 8


def test_pixels_come_in_the_order_of_the_cameras():
    """Pixel (b, y, x) at (b·H + y)·W + x, as ``Cameras`` has it."""
    ramp = np.arange(4 * 4, dtype=np.float32).reshape(1, 4, 4, 1) * [1, 2, 3, 0.01]
    p = pool(reference=CallableReference(lambda v: np.repeat(ramp, len(v), 0)))
    p.grow(2, 4)
    views, images, _ = p.batch(2)
    assert np.allclose(images.numpy(), np.tile(ramp.reshape(16, 4).T, 2), rtol=1e-3)
    assert (views.width, views.height, len(views)) == (4, 4, 2)


def test_another_resolution_empties_it():
    p = pool(capacity=5)
    p.grow(4, 4)
    p.grow(2, 8)
    assert held(p) == [5, 6] and p.resolution == 8
    _, images, _ = batch(p, 2)
    assert images.shape == (2, 8, 8, 4)
    p.grow(4, 8)
    assert held(p) == [6, 7, 8, 9, 10]  # the ring starts anew, too
    p.grow(0, 4)
    assert len(p) == 0


def test_the_seed_decides_everything():
    def run(seed):
        p = pool(capacity=4, seed=seed)
        out = []
        for _ in range(3):
            p.grow(2, 4)
            out.append(batch(p, 2)[1])
        return np.stack(out), p.reference.seeds

    (a, seeds_a), (b, seeds_b), (c, seeds_c) = run(1), run(1), run(2)
    assert np.array_equal(a, b) and seeds_a == seeds_b
    assert not np.array_equal(a, c) and set(seeds_a).isdisjoint(seeds_c)
    assert len(set(seeds_a)) == 3  # noise of its own for every batch


def test_residuals_belong_to_their_views():
    class Residual:
        def render(self, views, seed=0):
            images = np.zeros((len(views), views.height, views.width, 4), np.float32)
            images[..., :3] = -views.arrays()["origin"][:, None, None]
            return images

    p = pool(capacity=4, residual=Residual())
    p.grow(4, 4)
    arrays, images, residuals = batch(p, 2)
    residuals = residuals.reshape(2, 4, 4, 4)
    assert np.allclose(residuals[:, 1, 1, :3], -arrays["origin"], rtol=2e-3) and np.all(residuals[..., 3] == 0)
    assert np.allclose(images[:, 1, 1, 1:], arrays["origin"], rtol=2e-3)


@pytest.mark.parametrize("value", [1e6, 3e38])
def test_highlights_too_bright_for_half_precision_stay_finite(value):
    """A point light in a mirror reaches 1e5; infinity would make every parameter NaN."""
    p = pool(reference=CallableReference(lambda v: np.full((len(v), 4, 4, 4), value)))
    p.grow(2, 4)
    _, images, _ = batch(p, 2)
    assert np.isfinite(images).all() and images.min() > 6e4
