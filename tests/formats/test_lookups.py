"""Textures where files look them up: other UV sets, transforms, samplers; emission and occlusion beside them."""

import numpy as np
import pytest
from support.parts import FACES, LOW, QUAD, QUAD_UV, asset_of
from support.tiny_models import Glb, corner_pixels

from mi_simplify.formats.load import load_asset
from mi_simplify.initial.bake.baker import bake
from mi_simplify.machine.runtime import ensure_variant
from mi_simplify.model.asset import Lookup, Material, Part

PADS = {"repeat": "wrap", "mirror": "symmetric", "clamp": "edge"}
CODES = {"repeat": 10497, "mirror": 33648, "clamp": 33071}


def padded(image: np.ndarray, wrap_u: str, wrap_v: str) -> np.ndarray:
    """An image with a copy of itself on every side, as the wrap modes have them."""
    h, w = image.shape[:2]
    image = np.pad(image, ((h, h), (0, 0), (0, 0)), PADS[wrap_v])
    return np.pad(image, ((0, 0), (w, w), (0, 0)), PADS[wrap_u])


@pytest.mark.parametrize("wrap_u", PADS)
@pytest.mark.parametrize("wrap_v", PADS)
def test_beyond_the_image_lies_what_the_sampler_says(wrap_u, wrap_v):
    image = np.random.default_rng(0).random((4, 4, 4)).astype(np.float32)
    image[..., 3] = 1
    material = Material("m", image, lookups={"base_color": Lookup(0, (wrap_u, wrap_v))})
    baked = bake(asset_of(Part(QUAD, FACES, uvs=QUAD_UV * 3 - 1, material=material)), LOW, size=12, samples=1)
    np.testing.assert_allclose(baked.base_color, padded(image, wrap_u, wrap_v), atol=1e-4)


@pytest.mark.parametrize(("wrap_u", "wrap_v", "uvs"), [("mirror", "clamp", 0), ("repeat", "mirror", 1)])
def test_the_reference_looks_up_as_the_baker_does(wrap_u, wrap_v, uvs):
    ensure_variant()
    import mitsuba as mi

    from mi_simplify.scenes.shapes import asset_shapes

    image = np.random.default_rng(1).random((4, 4, 4)).astype(np.float32)
    material = Material("m", image, lookups={"base_color": Lookup(uvs, (wrap_u, wrap_v))})
    own = QUAD_UV * 3 - 1
    part = Part(QUAD, FACES, uvs=own if uvs == 0 else QUAD_UV, material=material, more_uvs=(own,) * uvs)
    scene = mi.load_dict({"type": "scene", **asset_shapes(asset_of(part))})
    k = (np.arange(12) + 0.5) / 12
    v, u = np.meshgrid(k, k, indexing="ij")
    low, high = QUAD.min(0), QUAD.max(0)
    corner = {tuple(uv): p for uv, p in zip(QUAD_UV.tolist(), QUAD, strict=True)}
    origin, right, down = corner[0, 0], corner[1, 0] - corner[0, 0], corner[0, 1] - corner[0, 0]
    assert (low <= origin).all() and (origin <= high).all()
    points = origin + u.reshape(-1, 1) * right + v.reshape(-1, 1) * down + [0, 0, 1]
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(points.T), mi.Vector3f(0, 0, -1)))
    found = si.bsdf().eval_diffuse_reflectance(si).numpy().T.reshape(12, 12, 3)
    np.testing.assert_allclose(found, padded(image, wrap_u, wrap_v)[..., :3], atol=1e-4)


def test_every_texture_of_a_gltf_file_has_coordinates_of_its_own(tmp_path):
    glb = Glb()
    texture = glb.texture(corner_pixels())
    glb.json["samplers"] = [{"wrapS": CODES["mirror"], "wrapT": CODES["clamp"]}]
    glb.json["textures"].append({"source": 0, "sampler": 0})
    half = {"KHR_texture_transform": {"scale": [3, 3], "offset": [-1, -1]}}
    glb.material(
        name="m",
        pbrMetallicRoughness={"baseColorTexture": {"index": texture, "texCoord": 1}},
        normalTexture={"index": glb.texture(np.uint8([[[128, 128, 255]]]))},
        emissiveTexture={"index": texture}, emissiveFactor=[1, 0.5, 0.25],
        occlusionTexture={"index": len(glb.json["textures"]) - 2, "extensions": half, "strength": 0.5},
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
    )  # fmt: skip
    primitive = glb.quad(0)
    flipped = np.float32([[1, 1], [0, 1], [0, 0], [1, 0]])
    primitive["attributes"]["TEXCOORD_1"] = glb.accessor(flipped)
    glb.mesh(primitive)
    asset = load_asset(glb.save(tmp_path / "a.glb"))
    assert asset.notes == ()
    (part,) = asset.parts
    low = type(LOW)(part.vertices, np.arange(4), part.uvs, part.faces)
    baked = bake(asset, low, size=24, samples=1)
    picture = np.kron(corner_pixels(2) / 255.0, np.ones((12, 12, 1)))
    clear = np.ones((24, 24), bool)
    clear[9:15] = clear[:, 9:15] = clear[:3] = clear[-3:] = clear[:, :3] = clear[:, -3:] = False  # blurred borders
    np.testing.assert_allclose(baked.base_color[..., :3][clear], picture[:, ::-1][clear], atol=1e-3)
    assert baked.emission is not None and baked.occlusion is not None
    np.testing.assert_allclose(baked.emission[clear], (picture * [4, 2, 1])[clear], atol=4e-3)
    assert baked.occlusion.shape == (24, 24, 1) and baked.occlusion.min() == pytest.approx(0.5, abs=1e-3)
