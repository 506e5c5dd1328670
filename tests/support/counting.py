"""A reference whose images say which view they are of."""

import numpy as np

from mi_simplify.scenes.views import goniometer


class Counting:
    """Images that say which view they are of: 1, 2, 3 … in red, and the view's own camera in green, blue, alpha."""

    def __init__(self):
        self.n, self.seeds = 0, []

    def render(self, views, seed=0):
        self.seeds.append(seed)
        images = np.ones((len(views), views.height, views.width, 4), np.float32)
        images[..., 0] = (self.n + 1 + np.arange(len(views)))[:, None, None]
        images[..., 1:] = views.arrays()["origin"][:, None, None]
        self.n += len(views)
        return images


def draw(n, rng, resolution):
    return [goniometer(n, rng, width=resolution, height=resolution, irradiance=np.pi)]
