"""
How rates, weights and resolution change over a run, all stretched to its length.
"""

from __future__ import annotations

#: The paper's number of steps, for which its decay constants hold.
PAPER_STEPS = 10_000


def exponential(progress: float, total: float) -> float:
    """
    Factor of a learning rate: 1 at progress 0, ``total`` at 1 (paper: 10^(-0.0002·step) over 10k steps).
    """
    return total**progress


def laplacian_weight(progress: float, floor: float) -> float:
    """
    Factor of the Laplacian's weight: ``λ_t = (λ_{t-1} - λ_min) 10^(-kt) + λ_min`` (Hasselgren et al. 2021, Sect. 5.3).

    Parameters
    ----------
    progress : float
        In [0, 1]; 1 is the paper's step 10,000, for which its k = 1e-6 holds.
    floor : float
        ``λ_min / λ_0``, 0.02 in the paper.
    """
    t = progress * PAPER_STEPS
    return floor + (1 - floor) * 10 ** (-1e-6 * t * (t + 1) / 2)


def resolution_at(progress: float, resolutions: tuple[int, ...]) -> int:
    """
    Coarse to fine: each resolution in turn, the last one for the second half of the run.
    """
    coarse = resolutions[:-1]
    if not coarse or progress >= 0.5:
        return resolutions[-1]
    return coarse[int(progress / 0.5 * len(coarse))]
