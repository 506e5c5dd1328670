"""
The linear model (Schneider et al. 2017): coefficients linear in shape parameters, here a PCA of the positions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .dataset import Dataset


@dataclass(frozen=True)
class LinearModel:
    """
    Parameters
    ----------
    mean : ndarray, shape (3n²,)
        Positions of the mean pose.
    axes : ndarray, shape (P, 3n²)
        Principal axes of the positions.
    matrix : ndarray, shape (P + 1, n² K)
        Transfer for each parameter, and for the mean pose in the last row.
    """

    mean: np.ndarray
    axes: np.ndarray
    matrix: np.ndarray

    def __call__(self, positions: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """
        Transfer, shape (T, n², K), for positions (T, n², 3); normals are not used.
        """
        parameters = (np.asarray(positions).reshape(len(positions), -1) - self.mean) @ self.axes.T
        rows = np.concatenate([parameters, np.ones((len(parameters), 1))], axis=1)
        return (rows @ self.matrix).reshape(len(positions), positions.shape[1], -1).astype(np.float32)

    @property
    def n_parameters(self) -> int:
        """Numbers that it consists of."""
        return self.mean.size + self.axes.size + self.matrix.size


def fit_linear(data: Dataset, n_axes: int = 32) -> LinearModel:
    """
    Least squares over the training frames.

    Parameters
    ----------
    data : Dataset
    n_axes : int
        Principal axes, at most one fewer than the frames.
    """
    poses = data.positions[data.training].reshape(len(data.training), -1).astype(np.float64)
    mean = poses.mean(0)
    u, s, axes = np.linalg.svd(poses - mean, full_matrices=False)
    kept = min(n_axes, int(np.count_nonzero(s > 1e-6 * s[0])), max(1, len(poses) // 4))
    rows = np.concatenate([u[:, :kept] * s[:kept], np.ones((len(poses), 1))], axis=1)
    targets = data.transfer[data.training].reshape(len(poses), -1)
    matrix = np.linalg.lstsq(rows, targets.astype(np.float64), rcond=None)[0]
    return LinearModel(mean.astype(np.float32), axes[:kept].astype(np.float32), matrix.astype(np.float32))
