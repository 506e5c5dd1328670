"""
One picture of a forest in a process of its own: ``python -m mi_simplify.jobs.forest_worker JOB.json``.

A process of its own, since it runs in Mitsuba's `scalar_rgb` variant, in which an instance costs next to nothing, while
the vectorised ones trace every single one into their kernels; and so that its peak memory is its own. Its materials
are Mitsuba's `principled`, which no fit has seen.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")

from ..formats.load import load_asset  # noqa: E402
from ..machine.meshes import make_mesh  # noqa: E402
from ..model.asset import Asset, Material, Part  # noqa: E402
from ..model.mesh import Mesh  # noqa: E402
from ..model.tangents import face_tangents  # noqa: E402
from ..scenes.samples.catalogue import sample_asset  # noqa: E402
from ..scenes.shapes import bitmap, part_normals  # noqa: E402


def principled(material: Material, mirrored: bool) -> dict:
    """
    A material as Mitsuba's own BSDFs have it; γ is left out.

    Parameters
    ----------
    mirrored : bool
        The faces show the texture mirrored: Mitsuba's bitangent knows no handedness, so green turns over.
    """
    out: dict = {
        "type": "principled", "base_color": bitmap(material.base_color[..., :3]), "specular": 0.5,
        "roughness": bitmap(material.specular[..., 1:2]), "metallic": bitmap(material.specular[..., 2:3]),
    }  # fmt: skip
    if material.normal is not None:
        normal = material.normal * np.array([1, -1 if mirrored else 1, 1], np.float32) * 0.5 + 0.5
        out = {"type": "normalmap", "normalmap": bitmap(normal), "bsdf": out}
    out = {"type": "twosided", "bsdf": out}
    if material.alpha_mode == "OPAQUE":
        return out
    opacity = material.base_color[..., 3:4]
    if material.alpha_mode == "MASK":
        opacity = (opacity >= material.alpha_cutoff).astype(np.float32)
    return {"type": "mask", "opacity": bitmap(opacity), "bsdf": out}


def group(asset: Asset) -> dict:
    """
    A plant as a shape group: all placements of a part are one mesh, since groups hold no instances.
    """
    out: dict = {"type": "shapegroup"}
    parts = [replace(p, normals=part_normals(p)) for p in asset.parts]
    for number, part in enumerate(parts):
        placements = tuple(replace(i, part=0) for i in asset.instances if i.part == number)
        if not placements:
            continue
        copies = Asset((part,), placements).placed()
        start = np.arange(len(copies))[:, None, None] * len(part.vertices)
        faces = (np.stack([c.faces for c in copies]) + start).reshape(-1, 3)
        vertices, normals = (np.concatenate([getattr(c, k) for c in copies]) for k in ("vertices", "normals"))
        uvs = None if part.uvs is None else np.tile(part.uvs, (len(copies), 1))
        for mirrored in (False, True):
            kept = faces[_mirrored(part, vertices, uvs, faces) == mirrored]
            if len(kept):
                bsdf = mi.load_dict(principled(part.material, mirrored))
                out[f"mesh_{number}_{int(mirrored)}"] = make_mesh(part.name, vertices, kept, normals, uvs, bsdf)
    return out


def _mirrored(part: Part, vertices: np.ndarray, uvs: np.ndarray | None, faces: np.ndarray) -> np.ndarray:
    """Whether each face shows a mirrored texture, where that matters."""
    if part.material.normal is None or uvs is None:
        return np.zeros(len(faces), bool)
    return face_tangents(Mesh(vertices, np.arange(len(vertices)), uvs, faces))[1] < 0


def scene(job: dict) -> dict:
    """
    The Mitsuba scene of a job.
    """
    placements, species = np.load(job["placements"]), np.load(job["species"])
    side, transparent = job["side"], False
    out: dict = {}
    for k, name in enumerate(job["assets"]):
        asset = sample_asset(name.removeprefix("sample:")) if name.startswith("sample:") else load_asset(name)
        transparent |= any(p.material.alpha_mode != "OPAQUE" for p in asset.parts)
        out[f"plant_{k}"] = mi.load_dict(group(asset))
    for k, (matrix, kind) in enumerate(zip(placements, species.tolist(), strict=True)):
        to_world = mi.ScalarTransform4f(matrix)
        out[f"copy_{k}"] = {"type": "instance", "to_world": to_world, "group": out[f"plant_{kind}"]}
    flat = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(0.6 * side)
    soil = {"type": "diffuse", "reflectance": {"type": "rgb", "value": job["ground"]}}
    out["ground"] = {"type": "rectangle", "to_world": flat, "bsdf": {"type": "twosided", "bsdf": soil}}
    if job["environment"] is None:
        out["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [0.8, 0.9, 1.0]}}
    else:
        out["sky"] = {"type": "envmap", "filename": job["environment"]}
    place, target = ([side * x for x in job[key]] for key in ("camera", "target"))
    out["sensor"] = {
        "type": "perspective", "fov": job["fov"], "fov_axis": "x", "near_clip": 1e-4 * side, "far_clip": 1e3 * side,
        "to_world": mi.ScalarTransform4f().look_at(place, target, [0, 1, 0]),
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm", "width": job["width"], "height": job["height"], "pixel_format": "rgb",
            "component_format": "float32", "rfilter": {"type": "box"},
        },
    }  # fmt: skip
    # `path` lets masked surfaces cast full shadows.
    out["integrator"] = {"type": "volpath" if transparent else "path", "max_depth": job["max_depth"]}
    return {"type": "scene", **out}


def main(path: str) -> None:
    """
    Render the job in a JSON file, the picture into its ``out``; costs go to standard output.
    """
    job = json.loads(Path(path).read_text(encoding="utf-8"))
    start = time.perf_counter()
    parts = scene(job)
    loaded = time.perf_counter()
    built = mi.load_dict(parts, optimize=False)
    ready = time.perf_counter()
    image = np.array(mi.render(built, spp=job["spp"], seed=job["seed"]))
    done = time.perf_counter()
    np.save(job["out"], image[..., :3].astype(np.float32))
    costs = {
        "load": loaded - start, "build": ready - loaded, "render": done - ready,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }  # fmt: skip
    sys.stdout.write("\n" + json.dumps(costs))


if __name__ == "__main__":
    main(sys.argv[1])
