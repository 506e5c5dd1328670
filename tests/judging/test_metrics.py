"""Image metrics against known values and against the judge's own formulas."""

from typing import Any

import flip_evaluator
import numpy as np
import pytest

from mi_simplify.judging.metrics import (
    compare,
    flip,
    flip_maps,
    normal_dissimilarity,
    psnr,
    silhouette_error,
    tonemap,
)


@pytest.fixture
def images() -> tuple[np.ndarray, np.ndarray]:
    """Two sets of non-square random pictures with some values out of range, as smooth as renderings are."""
    rng = np.random.default_rng(1)
    a = rng.random((3, 32, 48, 4)).astype(np.float32) * 1.2
    b = (a + rng.normal(0, 0.05, a.shape)).astype(np.float32)
    return a, b


def test_tonemap_known_values():
    x = tonemap(np.array([[-1.0, 0.0, 0.002, 9.0], [0.18, 0.5, 3.0, 9.0]]))
    np.testing.assert_allclose(x, [[0, 0, 0.02584], [0.46135613, 0.73535698, 1]], atol=1e-6)
    assert x.dtype == np.float32


def test_psnr_known_value_per_view():
    a = np.zeros((2, 4, 6, 3), np.float32)
    b = a.copy()
    b[1] = 0.5
    np.testing.assert_allclose(psnr(a, b), [100.0, -20 * np.log10(0.7353569)], rtol=1e-5)


def test_silhouette_error_counts_both_sides():
    a = np.zeros((2, 4, 4))
    a[:, :2] = 1.0  # 16 covered in all
    b = a.copy()
    b[0, 0, 0] = 0.4  # missing
    b[1, 3, 0] = 0.6  # too much
    b[1, 3, 1] = 0.5  # not covered yet
    assert silhouette_error(a, b) == 2 / 16
    assert silhouette_error(np.zeros((2, 2)), np.ones((2, 2))) == 4


def test_equals_the_judge(images):
    """The judge's own lines, on the same arrays."""
    a, b = images
    at, bt = tonemap(a), tonemap(b)
    mse = ((at - bt) ** 2).mean((1, 2, 3))
    pairs = zip(at, bt, strict=True)
    fl = [flip_evaluator.evaluate(np.ascontiguousarray(x), np.ascontiguousarray(y), "LDR")[1] for x, y in pairs]
    sil = np.abs((a[..., 3] > 0.5) != (b[..., 3] > 0.5)).sum() / max(1, (a[..., 3] > 0.5).sum())
    ours: dict[str, Any] = compare(a, b)
    assert ours["psnr"] == pytest.approx(float(np.mean(-10 * np.log10(np.maximum(mse, 1e-10)))), abs=1e-4)
    assert ours["flip"] == pytest.approx(float(np.mean(fl)), abs=1e-5)
    assert ours["silhouette_error"] == pytest.approx(float(sil), abs=1e-12)
    assert [len(v) for v in ours["per_view"].values()] == [3, 3, 3]
    assert ours["psnr"] == pytest.approx(np.mean(ours["per_view"]["psnr"]))


def test_flip_is_zero_for_equal_images_and_grows(images):
    a, b = images
    np.testing.assert_array_equal(flip(a, a), 0)
    worse = a + 3 * (b - a)
    assert (flip(a, worse) > flip(a, b)).all() and (flip(a, b) > 0).all()
    assert flip_maps(a, b).shape == (3, 32, 48)


def test_images_of_different_shapes_are_refused():
    with pytest.raises(ValueError, match="one shape"):
        psnr(np.zeros((1, 2, 2, 3)), np.zeros((1, 2, 3, 3)))


def test_noise_does_not_count_as_a_difference():
    generator = np.random.default_rng(3)
    plain = np.broadcast_to(np.float32([0.4, 0.5, 0.3, 1.0]), (2, 96, 128, 4))
    other = plain + np.float32([0.02, -0.02, 0.02, 0.0])
    noise = generator.normal(0, 0.03, (2, 2, *plain.shape)).astype(np.float32)
    a, b = plain + noise[0], other + noise[1]
    wanted, noisy = psnr(plain, other), psnr(a.mean(0), b.mean(0))
    found: dict[str, Any] = compare(a, b)
    assert (noisy < wanted - 2).all()
    np.testing.assert_allclose(found["per_view"]["psnr"], wanted, atol=0.5)
    assert compare(a, a)["psnr"] == 100.0
    assert compare(a, plain[None] + noise[1])["psnr"] > psnr(a.mean(0), plain).mean() + 8


def test_normal_dissimilarity_counts_what_is_not_flat():
    """Eq. 1 of Dressi's supplement: 1 - cos over the texels of the reference's relief, whatever lies elsewhere."""
    reference = np.zeros((2, 3, 3))
    reference[..., 2] = 1
    reference[0, 0] = [0.6, 0, 0.8]
    reference[1, 2] = [0, 1, 0]
    reference[0, 1] = [0.0039, 0.0039, 1]  # what 8 bits make of flat
    assert normal_dissimilarity(reference, reference) == 0
    ours = reference.copy()
    ours[0, 0], ours[1, 0] = [0, 0, 3.0], [1, 0, 0]
    assert normal_dissimilarity(ours, reference) == pytest.approx(0.1)
    shown = np.ones((2, 3), bool)
    shown[1, 2] = False
    assert normal_dissimilarity(ours, reference, shown) == pytest.approx(0.2)
    assert np.isnan(normal_dissimilarity(ours, np.zeros((2, 3, 3)) + [0, 0, 1]))
