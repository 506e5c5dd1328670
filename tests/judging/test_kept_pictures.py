"""Pictures of a reference are rendered once, whatever is judged beside it, and again where anything else is asked."""

from dataclasses import replace

import numpy as np
from support.parts import asset_of, grid, painted

from mi_simplify.judging.evaluate import Judging, compare_assets
from mi_simplify.judging.kept_pictures import KeptPictures
from mi_simplify.judging.renderers import PathTraced
from mi_simplify.model.asset import Asset, Part


def relief(height: float) -> Asset:
    """A bumpy square."""
    positions, faces = grid(6, lambda x, y: height * np.sin(5 * x) * np.cos(4 * y))
    return asset_of(Part(positions, faces, material=painted((0.6, 0.3, 0.2))))


def test_a_reference_is_rendered_once_and_figures_stay_as_they_are(monkeypatch):
    looks = []
    render = PathTraced.render

    def counted(self, views, seed=0):
        looks.append(self)
        return render(self, views, seed)

    monkeypatch.setattr(PathTraced, "render", counted)
    judging, kept = Judging(n_views=2, resolution=24, spp=4), KeptPictures()

    def judged(height: float, judging: Judging, kept: KeptPictures | None = None) -> tuple[dict, int]:
        looks.clear()
        row = compare_assets(relief(0.1), {"other": relief(height)}, judging, kept=kept).figures["candidates"]["other"]
        return {name: row[name] for name in ("psnr", "flip", "silhouette_error")}, len(looks)

    first, n = judged(0.05, judging, kept)
    assert n == 2 * 2 * 2, "two pictures of two views of both"
    again, n = judged(0.05, judging, kept)
    assert again == first and n == 2 * 2, "the other one alone"
    other, n = judged(0.08, judging, kept)
    assert n == 2 * 2 and other == judged(0.08, judging)[0]
    for change in ({"seed": 1}, {"spp": 6}, {"resolution": 20}, {"n_views": 3}):
        changed = replace(judging, **change)
        with_kept, n = judged(0.08, changed, kept)
        assert n == 4 * changed.n_views and with_kept == judged(0.08, changed)[0], change
