"""Random film sizes: which there are, how many views each has, and batches of as many pixels whatever the size."""

from functools import partial

import numpy as np
from support.counting import Counting, draw

from mi_simplify.config import load_config
from mi_simplify.fitting.pool import ViewPool
from mi_simplify.fitting.sizes import at_sizes, film_sizes


def test_sizes_shrink_by_root_two_in_whole_tiles():
    assert film_sizes(64, 16) == [64, 44, 32, 24, 16]
    assert film_sizes(64, None) == film_sizes(64, 64) == film_sizes(64, 100) == [64]
    assert all(s % 4 == 0 and 30 <= s <= 250 for s in film_sizes(250, 30)[1:])


def test_every_size_has_as_many_pixels():
    views = at_sizes(draw, 16, 40, np.random.default_rng(0), 64)
    pixels = np.array([len(v) * v.width * v.height for v in views])
    assert [v.width for v in views] == [64, 44, 32, 24, 16]
    assert np.ptp(pixels) < 0.2 * pixels.mean()
    assert abs(pixels.sum() / 64**2 - 40) < 4
    assert [len(v) for v in at_sizes(draw, None, 7, np.random.default_rng(0), 64)] == [7]


def test_batches_of_all_sizes_cost_the_same_and_come_as_often():
    sized = partial(at_sizes, draw, 16)
    pool = ViewPool(Counting(), sized, 500, np.random.default_rng(0))
    pool.grow(20, 64)
    seen = []
    for _ in range(300):
        views, images, _ = pool.batch(3)
        assert images.shape[1] == len(views) * views.width * views.height
        assert 2.5 < len(views) * views.width**2 / 64**2 <= 3
        seen.append(views.width)
    counts = np.unique(seen, return_counts=True)[1]
    assert len(counts) == 5 and counts.min() > 30


def test_a_target_resolution_sets_what_else_is_not_set():
    config = load_config(None, ["asset=a.obj", "optimizer.target_resolution=64", "latent.mips=custom"])
    assert config.optimizer.resolution == (64,) and config.optimizer.shade == "pixel" and config.optimizer.batch == 32
    assert config.reference.spp == 256 and config.initial.atlas_size == 256 and config.latent.mips == "custom"
    assert config.evaluation.resolution == 64
    plain = load_config(None, ["asset=a.obj"])
    assert plain.optimizer.shade == "sample" and plain.latent.mips == "none"
