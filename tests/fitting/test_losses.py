"""Image losses by hand: values, derivatives, the shared background, the coverage term."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mi_simplify.errors import ConfigError
from mi_simplify.fitting import losses

#: x, y of the hand-computed table.
X, Y = 0.5, 0.2


def f(x):
    return mi.Float(x)


def gamma(x):
    """IEC 61966-2-1, encoded from linear, in float64."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-12) ** (1 / 2.4) - 0.055)


def slope(function, x, eps=1e-6):
    return (function(x + eps) - function(x - eps)) / (2 * eps)


T_X, T_Y = (float(gamma(np.log(x + 1))) for x in (X, Y))
D_X = float(slope(lambda x: gamma(np.log(x + 1)), X))

#: name: (value, derivative by x) at (X, Y), from the formulas in the docstrings.
BY_HAND = {
    "log_l1": (T_X - T_Y, D_X),
    "log_l2": ((T_X - T_Y) ** 2, 2 * (T_X - T_Y) * D_X),
    "l1": (0.3, 1.0),
    "l2": (0.09, 0.6),
    "smape": (0.3 / 0.71, (0.71 - 0.3) / 0.71**2),
    "relative_l2": (0.09 / 0.05, 0.6 / 0.05),
}


def test_table_is_what_it_says():
    """The two figures that the table is made of, worked out with a pocket calculator."""
    assert (T_X, T_Y) == (pytest.approx(0.6693, abs=1e-4), pytest.approx(0.4641, abs=1e-4))
    # Γ'(t) / (x + 1) with t = log 1.5 = 0.405465: 1.055 / 2.4 · t^(-7/12) / 1.5
    assert pytest.approx(1.055 / 2.4 * 0.405465 ** (-1.4 / 2.4) / 1.5, rel=1e-4) == D_X
    assert set(BY_HAND) == set(losses.LOSSES)


@pytest.mark.parametrize("name", BY_HAND)
def test_value_and_derivative_by_hand(name):
    x = f(X)
    dr.enable_grad(x)
    value = losses.image_loss(name)(x, f(Y))
    dr.backward(value)
    assert value[0] == pytest.approx(BY_HAND[name][0], rel=1e-5)
    assert dr.grad(x)[0] == pytest.approx(BY_HAND[name][1], rel=1e-4)


@pytest.mark.parametrize("name", BY_HAND)
def test_zero_at_equality_and_only_there(name):
    loss, x = losses.image_loss(name), f([0.0, 1e-4, 0.003, 0.2, 1.0, 40.0, 1e4])
    y = mi.Float(x)
    dr.enable_grad(x)
    value = loss(x, y)
    dr.backward(value)
    assert dr.all(value == 0) and np.isfinite(dr.grad(x).numpy()).all()
    assert np.all(dr.grad(x).numpy() == 0)  # a pixel that is right pulls at nothing
    away = loss(dr.detach(x) * 1.1 + 1e-4, y).numpy()
    assert np.all(away > 0)
    assert np.allclose(loss(y, dr.detach(x) * 1.1 + 1e-4).numpy(), away, rtol=1e-5) or name == "relative_l2"


@pytest.mark.parametrize("name", BY_HAND)
def test_derivative_is_finite_at_black(name):
    """Γ's root has an infinite slope at 0, the linear part that is taken there has not, nor is it 0."""
    x = f([0.0, 0.0, 1e-8, 0.0031308])
    dr.enable_grad(x)
    dr.backward(losses.image_loss(name)(x, f([0.0, 0.5, 0.5, 0.5])))
    assert np.isfinite(dr.grad(x).numpy()).all()
    grad = dr.grad(x).numpy()
    assert np.all(grad[2:] < 0)  # brighter is nearer
    # At exactly 0 the tone-mapped losses say nothing, see tonemap_log.
    assert grad[1] == 0 if name.startswith("log") else grad[1] < 0


def test_srgb_values_and_derivatives():
    x = np.array([0.0, 0.001, 0.0031308, 0.0032, 0.18, 0.5, 1.0, 3.0])
    a = f(x.astype(np.float32))
    dr.enable_grad(a)
    y = losses.srgb(a)
    dr.backward(y)
    assert np.allclose(y.numpy(), gamma(x), atol=1e-6)
    assert (y[0], y[6]) == (0, pytest.approx(1, abs=1e-6))
    expected = np.where(x <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(x, 1e-9) ** (-1.4 / 2.4))
    assert np.allclose(dr.grad(a).numpy(), expected, rtol=1e-4)


def test_log_tonemapping_compresses_and_ignores_what_is_below_black():
    x = np.array([-1.0, 0.0, 1.0, np.e - 1, 1e6])
    got = losses.tonemap_log(f(x.astype(np.float32))).numpy()
    assert np.allclose(got, gamma(np.log(np.maximum(x, 0) + 1)), rtol=1e-5)
    assert got[0] == 0 and got[3] == pytest.approx(1, rel=1e-5)


def test_relative_losses_know_the_scale():
    """The same relative error costs about the same in a bright and a brighter pixel; black pixels stay bounded."""
    for name in ("smape", "relative_l2"):
        loss = losses.image_loss(name)
        assert loss(f(11.0), f(10.0))[0] == pytest.approx(loss(f(110.0), f(100.0))[0], rel=0.01)
    assert losses.smape(f(100.0), f(0.0))[0] < 1 and losses.relative_l2(f(0.1), f(0.0))[0] == pytest.approx(1, rel=1e-4)


def test_unknown_loss_is_named():
    with pytest.raises(ConfigError, match=r"unknown loss \(loss.image\) 'l3'; one of log_l1, log_l2, l1"):
        losses.image_loss("l3")


# --- a batch of pixels -----------------------------------------------------------------------------------------------


def batch(n=50, seed=0):
    rng = np.random.default_rng(seed)
    image, reference = rng.uniform(0.05, 1, (2, n, 4))
    image[:, :3] *= image[:, 3:]
    reference[:, :3] *= reference[:, 3:]
    return image, reference, rng.random((n, 3))


def vector(kind, x):
    return kind(np.ascontiguousarray(np.asarray(x, np.float32).T))


def ref_frame_loss(image, reference, background, loss, coverage):
    over = lambda x: x[:, :3] + (1 - x[:, 3:]) * background  # noqa: E731
    return np.mean(loss(over(image), over(reference))) + coverage * np.mean((image[:, 3] - reference[:, 3]) ** 2)


def frame_loss(image, reference, background, loss, coverage):
    value, grad = losses.frame_loss(
        vector(mi.Vector4f, image), vector(mi.Vector4f, reference), vector(mi.Color3f, background), loss, coverage
    )
    return value[0], grad.numpy().T


@pytest.mark.parametrize("coverage", [0.0, 0.7])
def test_frame_loss_and_its_derivative(coverage):
    image, reference, background = batch()
    l2 = lambda x, y: (x - y) ** 2  # noqa: E731
    value, grad = frame_loss(image, reference, background, losses.l2, dr.opaque(mi.Float, coverage))
    assert value == pytest.approx(ref_frame_loss(image, reference, background, l2, coverage), rel=1e-4)
    expected, eps = np.zeros((50, 4)), 1e-5
    for k in range(50):
        for c in range(4):
            d = np.zeros((50, 4))
            d[k, c] = eps
            a, b = (ref_frame_loss(image + s * d, reference, background, l2, coverage) for s in (1, -1))
            expected[k, c] = (a - b) / (2 * eps)
    assert np.allclose(grad, expected, rtol=1e-3, atol=1e-6)


def test_frame_loss_of_the_same_image_is_nothing():
    image, _, background = batch()
    for name in BY_HAND:
        value, grad = frame_loss(image, image, background, losses.image_loss(name), 1.0)
        assert value == 0 and np.all(grad == 0), name


def test_background_shows_a_wrong_coverage():
    """Black on black hides a hole; over a background it does not, even without the coverage term."""
    image, reference = np.zeros((1, 4)), np.array([[0.0, 0, 0, 1]])
    assert frame_loss(image, reference, np.zeros((1, 3)), losses.l1, 0.0)[0] == 0
    value, grad = frame_loss(image, reference, np.full((1, 3), 0.6), losses.l1, 0.0)
    assert value == pytest.approx(0.6) and grad[0, 3] == pytest.approx(-0.6)
    value, grad = frame_loss(image, reference, np.zeros((1, 3)), losses.l1, 0.5)
    assert value == pytest.approx(0.5) and grad[0, 3] == pytest.approx(-1)


def test_pixels_without_a_reference_do_not_count():
    image, reference = mi.Vector4f([0.2, 0.4], 0.5, 0.6, 1.0), mi.Vector4f([np.nan, 0.9], 0.1, 0.1, 1.0)
    value, grad = losses.frame_loss(image, reference, mi.Color3f(0), losses.l1, 1.0)
    assert value.numpy() == pytest.approx((0.5 + 0.4 + 0.5) / 3 / 2)
    np.testing.assert_array_equal(grad.numpy()[:, 0], 0)
    assert np.abs(grad.numpy()[:3, 1]).min() > 0.1
