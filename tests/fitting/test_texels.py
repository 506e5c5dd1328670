"""Adam on packed textures: against a dense Adam in NumPy, and what it must leave alone."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.fitting.parameters.texels import TexelAdam
from mi_simplify.latent.footprint import BLOCK
from mi_simplify.latent.texel_gradient import TexelGradient
from mi_simplify.latent.textures import Textures

RATES = dict(base_color=0.01, roughness=0.02, metallic=0.005, normal=0.03, opacity=0.015, gamma=0.025)
CHANNEL_RATES = np.array([0.01] * 3 + [0.02, 0.005] + [0.03] * 3 + [0.015, 0.025, 0, 0])


def textures(height=5, width=3, extended=True, seed=0):
    """15 texels: the tile that they lie in is not full. Values in the middle of their ranges."""
    rng = np.random.default_rng(seed)
    base, specular = (rng.uniform(0.4, 0.6, (height, width, c)).astype(np.float32) for c in (4, 3))
    normal = rng.normal(size=(height, width, 3)) * 0.2 + [0, 0, 1]
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return Textures(base, specular, normal.astype(np.float32), extended)


def stored():
    """Where the 15 texels lie, row by row."""
    return textures().place(*np.indices((5, 3))).ravel()


def values(t):
    return t.data.numpy().reshape(-1, t.n_channels)[stored()]


def gradient(dense, blocks=None):
    """A gradient in blocks, from one of all texels, shape (T, C)."""
    n = textures().n_stored // BLOCK
    padded = np.zeros((n * BLOCK, dense.shape[1]), np.float32)
    padded[stored()] = dense
    blocks = np.arange(n) if blocks is None else np.asarray(blocks)
    packed = padded.reshape(n, -1)[blocks]
    # Not NumPy's memory, whose alignment changes from call to call and with it the kernel.
    packed = mi.Float(packed.ravel()) + dr.opaque(mi.Float, 0)
    blocks = mi.UInt32(blocks.astype(np.uint32)) + dr.opaque(mi.UInt32, 0)
    dr.eval(packed, blocks)
    return TexelGradient(blocks, packed)


def one():
    return dr.opaque(mi.Float, 1)


class DenseAdam:
    """Kingma and Ba 2015, Algorithm 1, on all texels at once, with the normals kept unit."""

    def __init__(self, x, beta1=0.9, beta2=0.99):
        self.x, self.m, self.v, self.t, self.beta = x.astype(np.float64), 0 * x, 0 * x, 0, (beta1, beta2)

    def step(self, g, rates):
        (b1, b2), self.t = self.beta, self.t + 1
        self.m, self.v = b1 * self.m + (1 - b1) * g, b2 * self.v + (1 - b2) * g**2
        self.x = self.x - rates * (self.m / (1 - b1**self.t)) / np.sqrt(self.v / (1 - b2**self.t))
        self.x[:, 5:8] /= np.linalg.norm(self.x[:, 5:8], axis=1, keepdims=True)


@pytest.mark.parametrize("extended", [False, True])
def test_texels_that_are_always_seen_follow_a_dense_adam(extended):
    t, rng = textures(extended=extended), np.random.default_rng(1)
    adam, reference = TexelAdam(t, RATES, 0.03), DenseAdam(values(t))
    for k in range(8):
        g = rng.normal(size=(15, t.n_channels)) * 10.0 ** rng.uniform(-3, 3, (1, t.n_channels))
        factor = 0.9**k
        adam.step(gradient(g), dr.opaque(mi.Float, factor))
        reference.step(g, CHANNEL_RATES[: t.n_channels] * factor)
        # Channels without a rate (padding) move nowhere, whatever their gradient.
    assert np.allclose(values(t), reference.x, atol=2e-5)
    assert np.abs(values(t) - values(textures(extended=extended)))[:, :5].min() > 1e-6


def test_first_step_has_the_length_of_the_rate():
    t = textures()
    before = values(t)
    sign = np.random.default_rng(2).choice([-1.0, 1.0], (15, 12))
    TexelAdam(t, RATES, 0.03).step(gradient(1e-6 * sign), one())
    expected = before - CHANNEL_RATES * sign
    scalars = [0, 1, 2, 3, 4, 8, 9, 10, 11]
    assert np.allclose(values(t)[:, scalars], expected[:, scalars], atol=1e-6)


def test_unseen_texels_stay_as_they_are_bit_for_bit():
    t, rng = textures(), np.random.default_rng(3)
    adam, before = TexelAdam(t, RATES, 0.03), values(t)
    seen = np.zeros(15, bool)
    seen[[0, 1, 12]] = True  # two of the first block, one of the third; the second and fourth are not even touched
    for _ in range(5):
        adam.step(gradient(rng.normal(size=(15, 12)) * seen[:, None], blocks=[0, 2]), one())
    after, state = values(t), adam.state()
    assert np.array_equal(after[~seen], before[~seen]) and np.all(np.any(after[seen] != before[seen], axis=1))
    m, v = (state[k].reshape(-1, 12)[stored()] for k in "mv")
    assert np.all(m[~seen] == 0) and np.all(v[~seen] == 0) and np.all(v[seen] > 0)
    assert np.array_equal(state["count"][stored()], 5.0 * seen)


def test_texels_seen_late_start_as_gently_as_the_first():
    a, b = textures(), textures()
    early, late, rng = TexelAdam(a, RATES, 0.03), TexelAdam(b, RATES, 0.03), np.random.default_rng(4)
    g = rng.normal(size=(3, 15, 12))
    others = g * (np.arange(15) > 7)[None, :, None]
    for k in range(3):
        late.step(gradient(others[k]), one())
    assert np.array_equal(values(b)[:8], values(a)[:8])
    for k in range(3):
        early.step(gradient(g[k]), one())
        late.step(gradient(g[k]), one())
    assert np.allclose(values(a)[:8], values(b)[:8], atol=1e-7)
    assert not np.allclose(values(a)[8:], values(b)[8:], atol=1e-4)


@pytest.mark.parametrize("direction", [-1, 1])
def test_everything_stays_in_its_range(direction):
    t = textures()
    adam = TexelAdam(t, {k: 0.3 for k in RATES}, 0.15)
    g = np.full((15, 12), -float(direction))
    for _ in range(8):
        adam.step(gradient(g), one())
    x = values(t)
    assert np.allclose(x[:, [0, 1, 2, 4, 8, 9]], max(0, direction))
    assert np.allclose(x[:, 3], 1 if direction > 0 else 0.15)
    normal = x[:, 5:8]
    assert np.allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-5) and normal[:, 2].min() > 0
    if direction < 0:  # pushed below the surface, it stays just above
        assert normal[:, 2].max() < 0.1


def test_rate_zero_keeps_a_texture():
    t, before = textures(), values(textures())
    adam, rng = TexelAdam(t, {"normal": 0.05}, 0.03), np.random.default_rng(5)
    for _ in range(3):
        adam.step(gradient(rng.normal(size=(15, 12))), one())
    after = values(t)
    others = [0, 1, 2, 3, 4, 8, 9]
    assert np.array_equal(after[:, others], before[:, others])
    assert np.abs(after[:, 5:8] - before[:, 5:8]).max() > 0.01


def test_state_comes_back():
    """A restored optimiser goes on exactly where the other stopped, and neither writes into what was saved."""
    rng = np.random.default_rng(6)
    g = rng.normal(size=(6, 15, 12))
    a, b = textures(), textures()
    whole, half = TexelAdam(a, RATES, 0.03), TexelAdam(b, RATES, 0.03)
    for k in range(6):
        whole.step(gradient(g[k]), one())
    for k in range(3):
        half.step(gradient(g[k]), one())
    saved = half.state()
    kept = {k: v.copy() for k, v in saved.items()}
    again = TexelAdam(b, RATES, 0.03)
    again.restore(saved)
    half.textures = textures()
    half.step(gradient(g[3]), one())  # the state that was taken is of that moment
    for k in range(3, 6):
        again.step(gradient(g[k]), one())
    assert np.array_equal(values(a), values(b))
    assert all(np.array_equal(saved[k], kept[k]) for k in saved)


def test_no_kernel_is_compiled_for_other_numbers():
    t = textures()
    adam, rng = TexelAdam(t, RATES, 0.03), np.random.default_rng(7)
    for _ in range(2):
        adam.step(gradient(rng.normal(size=(15, 12))), dr.opaque(mi.Float, 1))
    grads = [gradient(rng.normal(size=(15, 12))) for _ in range(3)]
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for k, g in enumerate(grads):
            adam.step(g, dr.opaque(mi.Float, 0.9**k))
        history = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert history and all(k["cache_hit"] for k in history)
    assert len({k["hash"] for k in history}) <= len(history) // 3
