"""Packed textures: bilinear lookup with wrap, its derivative by the UV, its transpose, and the way back to images."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.latent.footprint import BLOCK
from mi_simplify.latent.texel_gradient import TexelGradient, TouchedBlocks
from mi_simplify.latent.textures import Textures


def images(height, width, seed=0):
    """Base colour, specular and unit normals, random."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(height, width, 3)) * 0.3 + [0, 0, 1]
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return (*(rng.random((height, width, c)).astype(np.float32) for c in (4, 3)), normal.astype(np.float32))


def planes(base_color, specular, normal, extended):
    """Channels in the order in which a lookup gives them."""
    out = [base_color[..., :3], specular[..., 1:3], normal]
    if extended:
        out += [base_color[..., 3:4], specular[..., :1], 0 * base_color[..., :2]]
    return np.concatenate(out, axis=2).astype(np.float64)


def ref_lookup(image, u, v):
    """Bilinear with texel centres at (k + .5) / N, repeating; values and derivatives by u and v, in float64."""
    h, w = image.shape[:2]
    x, y = u * w - 0.5, v * h - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    a, b = image[y0 % h, x0 % w], image[y0 % h, (x0 + 1) % w]
    c, d = image[(y0 + 1) % h, x0 % w], image[(y0 + 1) % h, (x0 + 1) % w]
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    return value, ((b - a) * (1 - fy) + (d - c) * fy) * w, ((c - a) * (1 - fx) + (d - b) * fx) * h


def floats(x):
    return mi.Float(np.asarray(x, np.float32))


def lookup(textures, u, v):
    return textures.lookup(textures.footprint(floats(u), floats(v))).numpy().T


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize(("height", "width"), [(8, 16), (5, 41), (1, 1), (1, 7)])
def test_lookup_is_bilinear_and_repeats(height, width, extended):
    three = images(height, width)
    textures, rng = Textures(*three, extended=extended), np.random.default_rng(1)
    u, v = rng.uniform(-2.5, 3.5, (2, 3000)).astype(np.float32).astype(np.float64)
    expected, _, _ = ref_lookup(planes(*three, extended=extended), u, v)
    got = lookup(textures, u, v)
    assert got.shape == (3000, 12 if extended else 8)
    slope = 3.5 * max(height, width) * 1e-6
    assert np.abs(got - expected).max() < 1e-5 + slope


@pytest.mark.parametrize("n", [2, 3, 7, 41, 47, 100, 512])
def test_lookup_at_texel_centres_and_across_the_border(n):
    three = images(n, n)
    textures, image = Textures(*three), planes(*three, extended=False)
    centres = (np.arange(n) + 0.5) / n
    assert np.allclose(lookup(textures, centres, centres), image[np.arange(n), np.arange(n)], atol=1e-4)
    # Just past the last texel, where a float's rounding must not wrap to the wrong side, as often as one likes.
    for turn in (0, 1, 2):
        u = (np.array([n - 0.25, n, n + 0.25, n + 0.5, n + 1]) / n + turn).astype(np.float32)
        expected, _, _ = ref_lookup(image, u.astype(np.float64), np.full(5, 0.5 / n))
        assert np.allclose(lookup(textures, u, np.full(5, 0.5 / n)), expected, atol=2e-4 * (1 + turn) * n / 41)


def test_derivative_by_the_uv():
    three = images(6, 10)
    textures, rng = Textures(*three), np.random.default_rng(2)
    u, v = (((rng.integers(-3, 20, 500) + rng.uniform(0.1, 0.9, 500) + 0.5) / n) for n in (10, 6))
    _, du, dv = ref_lookup(planes(*three, extended=False), u, v)
    weight = rng.normal(size=(500, 8))
    for column, (du_, dv_) in enumerate(zip((du * weight).T, (dv * weight).T, strict=True)):
        a, b = floats(u), floats(v)
        dr.enable_grad(a, b)
        dr.backward(textures.lookup(textures.footprint(a, b))[column] * floats(weight[:, column]))
        assert np.allclose(dr.grad(a).numpy(), du_, atol=2e-3) and np.allclose(dr.grad(b).numpy(), dv_, atol=2e-3)


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize(("height", "width"), [(8, 8), (3, 5), (16, 9), (33, 40)])
def test_gradient_is_the_transposed_lookup(height, width, extended):
    """⟨lookup(x), g⟩ = ⟨x, lookupᵀ(g)⟩, in the touched blocks and nowhere else."""
    textures, rng = Textures(*images(height, width), extended=extended), np.random.default_rng(3)
    n = 40
    u, v = rng.uniform(-0.2, 0.7, (2, n))  # leaves a part of the texture alone
    footprint = textures.footprint(floats(u), floats(v))
    flags = TouchedBlocks.flags(textures, footprint)
    dr.eval(flags)
    g = rng.normal(size=(textures.n_channels, n)).astype(np.float32)
    collected = TexelGradient.collect(textures, footprint, TouchedBlocks.of(textures, flags), mi.ArrayXf(g))
    dense = collected.dense(textures).numpy().reshape(height, width, textures.n_channels)

    expected = np.zeros((height, width, textures.n_channels))
    x0, y0 = np.floor(u * width - 0.5).astype(int), np.floor(v * height - 0.5).astype(int)
    fx, fy = u * width - 0.5 - x0, v * height - 0.5 - y0
    for dx, dy, w in ((0, 0, (1 - fx) * (1 - fy)), (1, 0, fx * (1 - fy)), (0, 1, (1 - fx) * fy), (1, 1, fx * fy)):
        np.add.at(expected, ((y0 + dy) % height, (x0 + dx) % width), w[:, None] * g.T)
    assert np.allclose(dense, expected, atol=1e-4)
    value = lookup(textures, u, v)
    place = textures.place(*np.indices((height, width)))
    data = textures.data.numpy().reshape(-1, textures.n_channels)[place]
    assert np.sum(value * g.T) == pytest.approx(np.sum(dense * data), rel=1e-3)
    blocks = collected.blocks.numpy()
    assert np.array_equal(blocks, np.unique(place[np.any(expected != 0, axis=2)] // BLOCK))
    assert len(blocks) < textures.n_stored // BLOCK or height < 33


@pytest.mark.parametrize(("height", "width"), [(1, 1), (8, 8), (17, 9), (16, 24)])
def test_every_texel_has_a_place_of_its_own(height, width):
    textures = Textures(*images(height, width))
    place = textures.place(*np.indices((height, width)))
    assert len(np.unique(place)) == height * width and place.max() < textures.n_stored < (height + 8) * (width + 8)
    assert np.all(np.ptp(place[:8, :8]) < 64)  # a tile is in one piece


def test_room_for_gradients_hardly_ever_changes():
    textures, rng = Textures(*images(256, 256)), np.random.default_rng(4)
    room = textures.gradient_room(1000)
    assert 1500 <= room < 2000
    assert {textures.gradient_room(int(n)) for n in rng.integers(1, 1500, 50)} == {room}
    assert room < textures.gradient_room(2500) <= textures.n_stored // BLOCK == textures.gradient_room(4000)


def test_images_come_back():
    three = images(5, 7)
    base, specular, normal = three
    full = Textures(*three, extended=True).images()
    assert np.array_equal(full["base_color"], base) and np.array_equal(full["specular"], specular)
    assert np.allclose(full["normal"], normal, atol=1e-6)
    plain = Textures(*three).images()
    assert np.array_equal(plain["base_color"][..., :3], base[..., :3]) and np.all(plain["base_color"][..., 3] == 1)
    assert np.array_equal(plain["specular"][..., 1:], specular[..., 1:]) and np.all(plain["specular"][..., 0] == 0)
    long = Textures(base, specular, normal * 3).images()["normal"]
    assert np.allclose(np.linalg.norm(long, axis=2), 1, atol=1e-6)
    assert all(x.dtype == np.float32 for x in full.values())


@pytest.mark.parametrize("extended", [False, True])
def test_channels_have_the_names_that_they_were_given_by(extended):
    base, specular, normal = (np.arange(c, dtype=np.float32)[None, None] / 10 + o for c, o in ((4, 0), (3, 1), (3, 2)))
    textures = Textures(base, specular, normal, extended)
    t = textures.unpack(textures.lookup(textures.footprint(floats([0.3]), floats([0.8]))))
    assert t.base_color.numpy().ravel().tolist() == pytest.approx([0, 0.1, 0.2])
    assert (t.roughness[0], t.metallic[0]) == pytest.approx((1.1, 1.2))
    assert t.normal.numpy().ravel().tolist() == pytest.approx([2, 2.1, 2.2])
    assert (t.opacity[0], t.gamma[0]) == (pytest.approx((0.3, 1.0)) if extended else (1, 0))
    assert textures.extended == extended


def test_textures_own_their_memory():
    """The optimiser writes in place: never into the arrays that the first guess still holds."""
    base, specular, normal = images(4, 4)
    textures = Textures(base, specular, normal)
    dr.scatter(textures.data, mi.Float(7), mi.UInt32(0))
    dr.eval(textures.data)
    assert textures.images()["base_color"][0, 0, 0] == 7 and base[0, 0, 0] < 1


def chain(textures):
    """All levels of unpacked images as the packed planes of :func:`planes`."""
    return [planes(**textures.images(k), extended=textures.extended) for k in range(textures.n_levels)]


@pytest.mark.parametrize(("height", "width"), [(16, 16), (8, 32), (1, 4)])
def test_derived_levels_are_means_of_four(height, width):
    three = images(height, width)
    textures = Textures(*three, extended=True, mips="derived")
    data = textures.data.numpy().reshape(-1, 12)
    levels = [data[textures.places(k).numpy()].reshape(*textures.size(k), 12) for k in range(textures.n_levels)]
    assert levels[-1].shape == (1, 1, 12) and np.allclose(levels[0], planes(*three, extended=True), atol=1e-6)
    for fine, coarse in zip(levels, levels[1:], strict=False):
        h, w = coarse.shape[:2]
        assert np.allclose(coarse, fine.reshape(h, len(fine) // h, w, fine.shape[1] // w, 12).mean((1, 3)), atol=1e-6)


def test_trilinear_lookup_and_its_derivatives():
    three, rng = images(16, 32), np.random.default_rng(5)
    textures = Textures(*three, mips="custom")
    u, v = rng.uniform(-1, 2, (2, 500)).astype(np.float32).astype(np.float64)
    level = np.r_[rng.uniform(0.05, 4.95, 496), 0, 1, 3, 5]
    packed = textures.data.numpy().reshape(-1, 8)
    levels = [packed[textures.places(k).numpy()].reshape(*textures.size(k), 8) for k in range(textures.n_levels)]
    low = np.minimum(np.floor(level).astype(int), 4)
    values = [ref_lookup(image, u, v) for image in levels]
    pick = lambda part, k: np.stack([values[j][part][i] for i, j in enumerate(k)])  # noqa: E731
    a, b, f = pick(0, low), pick(0, low + 1), (level - low)[:, None]
    lu, lv, ll = floats(u), floats(v), floats(level)
    dr.enable_grad(lu, lv, ll)
    got = textures.lookup(textures.footprint(lu, lv, ll))
    assert np.abs(got.numpy().T - (a * (1 - f) + b * f)).max() < 1e-4
    weight = rng.normal(size=8).astype(np.float32)
    dr.backward(dr.sum(got * mi.ArrayXf([mi.Float(float(w)) for w in weight]), axis=0))
    inside = np.flatnonzero(np.abs((level % 1) - 0.5) < 0.49)
    for part, leaf in ((1, lu), (2, lv)):
        expected = (pick(part, low) * (1 - f) + pick(part, low + 1) * f) @ weight
        assert np.median(np.abs(dr.grad(leaf).numpy() - expected)) < 1e-3
    assert np.allclose(dr.grad(ll).numpy()[inside], ((b - a) @ weight)[inside], atol=2e-3)


@pytest.mark.parametrize("mips", ["derived", "custom"])
def test_gradient_of_levels_is_the_transposed_lookup(mips):
    """⟨lookup(x), g⟩ = ⟨x, lookupᵀ(g)⟩ over what is a parameter: one level, or all."""
    textures, rng = Textures(*images(32, 16), extended=True, mips=mips), np.random.default_rng(6)
    n = 60
    u, v, level = rng.uniform(0, 1, n), rng.uniform(0, 1, n), rng.uniform(0, 5, n)
    footprint = textures.footprint(floats(u), floats(v), floats(level))
    flags = TouchedBlocks.flags(textures, footprint)
    g = rng.normal(size=(12, n)).astype(np.float32)
    grad = TexelGradient.collect(textures, footprint, TouchedBlocks.of(textures, flags), mi.ArrayXf(g))
    value = textures.lookup(footprint).numpy()
    folded = grad.by_parameters(textures).spread_out(textures).numpy()
    assert np.sum(value * g) == pytest.approx(np.sum(folded * textures.data.numpy()), rel=1e-3)
    beyond = textures.offsets.numpy()[1] * 12
    assert folded[beyond:].any() == (mips == "custom")


def test_mips_want_powers_of_two():
    with pytest.raises(ValueError, match="powers of two"):
        Textures(*images(12, 16), mips="derived")
