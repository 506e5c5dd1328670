"""A small job for the tests of commands: a sphere with waves and colours, settings that make its run short."""

from pathlib import Path

import numpy as np

TOY = ["--set", "initial.atlas_size=64", "--set", "evaluation.resolution=64", "--set", "evaluation.spp=8",
       "--set", "evaluation.views=4", "--set", "reference.spp=8", "--set", "optimizer.resolution=64"]  # fmt: skip


def bumpy_sphere(folder: Path, n: int = 40, height: float = 0.05) -> Path:
    """A sphere of 2n² triangles with waves of this height and, per octant, another vertex colour, as PLY."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n), indexing="ij")
    theta, phi = np.pi * i / n, 2 * np.pi * j / n
    d = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], -1).reshape(-1, 3)
    points = d * (1 + height * np.sin(6 * d).sum(1, keepdims=True))
    a, b = (i * n + j)[:-1].ravel(), (i * n + (j + 1) % n)[:-1].ravel()
    faces = np.concatenate([np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)])
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x:.6f} {y:.6f} {z:.6f} {55 + 200 * (x > 0)} {55 + 200 * (y > 0)} 90\n" for x, y, z in points]
    path = folder / "sphere.ply"
    path.write_text(head + "".join(rows) + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces))
    return path


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}
