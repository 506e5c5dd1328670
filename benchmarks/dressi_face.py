"""
A morphable face from landmarks (Takimoto et al. 2022, supplement, Sect. 2.3): what poses, scale and weights from 68
landmarks of four views alone reach, before anything is rendered.

    .venv/bin/python benchmarks/dressi_face.py ../shared/assets/face/ict_face.npz

Synthetic subjects have random weights of identity and expression, four cameras of 480 × 640, and a pixel of noise.
Figures: mean distance of vertices after rigid alignment, by the head's height [%], of the mean face (at the best
scale), of landmarks alone (also at the best scale, which they cannot know), and of landmarks with their depth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mi_simplify.fitting.landmarks import aligned, fit_landmarks

FOCAL, SIZE = 900.0, (480, 640)
KINDS = ("mean face", "landmarks", "landmarks with depth")


def views(points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks in four images, shape (4, L, 2), and their depths, (4, L); the head turns in front of the camera."""
    angles = np.radians([[0, 0, 0], [0, 35, 0], [0, -35, 0], [20, 0, 0]] + rng.normal(size=(4, 3)) * 4)
    turned = Rotation.from_euler("zyx", angles[:, ::-1]).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    local = np.einsum("bij,lj->bli", turned, points) + [0, 0, 65] + rng.normal(size=(4, 1, 3)) * [1, 1, 3]
    return FOCAL * local[..., :2] / local[..., 2:] + np.array(SIZE) / 2, local[..., 2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("face", type=Path, help="ict_face.npz")
    parser.add_argument("--subjects", type=int, default=10)
    parser.add_argument("--modes", type=int, default=30, help="of identity, which are fitted with all expressions")
    parser.add_argument("--noise", type=float, default=1.0, help="of landmarks [pixels]")
    options = parser.parse_args()
    data = np.load(options.face)
    neutral, marks = data["neutral"].astype(np.float64), data["landmarks"]
    identity, expression = (data[name].astype(np.float64) for name in ("identity", "expression"))
    height, fitted = np.ptp(neutral[:, 1]), np.concatenate([identity[: options.modes], expression])
    rows = []
    for seed in range(options.subjects):
        rng = np.random.default_rng(seed)
        who, how = (
            rng.normal(size=len(identity)),
            rng.uniform(0, 0.6, len(expression)) * (rng.random(len(expression)) < 0.1),
        )
        true = neutral + np.tensordot(who, identity, axes=1) + np.tensordot(how, expression, axes=1)
        seen, depth = views(true[marks], rng)
        seen = seen + options.noise * rng.normal(size=seen.shape)
        found = [neutral]
        for known in (None, depth):
            fit = fit_landmarks(neutral[marks], fitted[:, marks], seen, FOCAL, SIZE, depth=known)
            found.append(fit.scale * (neutral + np.tensordot(fit.weights, fitted, axes=1)))
        moved = [aligned(x, true, with_scale=k < 2) for k, x in enumerate(found)]
        rows.append([100 * np.linalg.norm(x - true, axis=1).mean() / height for x in moved])
        print(
            f"subject {seed}: " + ", ".join(f"{n} {x:.2f} %" for n, x in zip(KINDS, rows[-1], strict=True)), flush=True
        )
    print(f"mean of {len(rows)}: " + ", ".join(f"{n} {x:.2f} %" for n, x in zip(KINDS, np.mean(rows, 0), strict=True)))


if __name__ == "__main__":
    main()
