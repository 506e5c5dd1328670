"""
Runs xatlas in a process of its own, so that a hanging unwrap can be ended; a script, imported by nothing.

stdin: an npz with ``positions`` (P, 3), ``faces`` (F, 3), ``normals`` (P, 3), ``size``, ``padding``, ``attempts``.
stdout: an npz with ``index`` (V,), ``uvs`` (V, 2) in texels, ``faces`` (F, 3), ``charts``.
"""

import io
import sys

import numpy as np
import xatlas


def pack(positions, faces, normals, padding, size, density):
    """
    Charts and one page of them; returns the atlas. ``density`` [texels per unit], 0 for a guess from ``size``.
    """
    atlas = xatlas.Atlas()
    atlas.add_mesh(positions, faces, normals)
    charts = xatlas.ChartOptions()
    charts.max_iterations = 4
    charts.normal_seam_weight = 0  # creases need two normals, not two charts
    charts.fix_winding = True  # no mirrored charts: turning them by a transposition is what mirrors
    packing = xatlas.PackOptions()
    packing.rotate_charts = False
    packing.padding = (padding + 1) // 2  # it pads both charts of a pair
    packing.resolution = size if density == 0 else 0
    packing.texels_per_unit = density
    atlas.generate(charts, packing)
    return atlas


def main():
    """
    Search for the density at which one page just fits ``size``; keep the densest of all attempts.
    """
    job = np.load(io.BytesIO(sys.stdin.buffer.read()))
    size, padding = int(job["size"]), int(job["padding"])
    positions, faces = job["positions"].astype(np.float32), job["faces"].astype(np.uint32)
    normals = job["normals"].astype(np.float32)
    inner = size - padding  # half the padding along every border
    density, best = 0.0, None
    for _ in range(int(job["attempts"])):
        atlas = pack(positions, faces, normals, padding, inner, density)
        if atlas.atlas_count == 0 or atlas.width == 0:
            break
        if atlas.atlas_count == 1:
            fit = inner / max(atlas.width, atlas.height)
            if best is None or atlas.texels_per_unit * fit > best[0]:
                index, triangles, uvs = atlas.get_mesh(0)
                texels = uvs.astype(np.float64) * [atlas.width, atlas.height] * fit + padding / 2
                best = (atlas.texels_per_unit * fit, index, triangles, texels, atlas.chart_count)
            density = atlas.texels_per_unit * min(fit, 1.2) * 1.004
        else:
            density = atlas.texels_per_unit * 0.8
    if best is None:
        sys.exit("xatlas found no chart")
    out = io.BytesIO()
    np.savez(out, index=best[1], faces=best[2], uvs=best[3], charts=best[4])
    sys.stdout.buffer.write(out.getvalue())


if __name__ == "__main__":
    main()
