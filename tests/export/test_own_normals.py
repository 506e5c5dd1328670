"""A normal map turned into the frame of the mesh's own normals shows the same surface."""

from dataclasses import replace

import numpy as np
import pytest
from support.models import displaced_sphere as model
from support.toy import TOY, bumpy_sphere

from mi_simplify import cli
from mi_simplify.export.own_normals import with_own_normals
from mi_simplify.judging.screen import Screen
from mi_simplify.model.model import tessellated
from mi_simplify.scenes.views import look_at


def shared(size=256):
    """A fine mesh shaded with the normals of a coarse one, and a wavy normal map."""
    start = model(4, subdivisions=3)
    assert start.displacement is not None
    y, x = np.indices((size, size)) / size * 2 * np.pi
    normal = np.stack([0.3 * np.sin(3 * x), 0.3 * np.cos(2 * y), np.ones_like(x)], axis=2)
    normal = np.float32(normal / np.linalg.norm(normal, axis=2, keepdims=True))
    several = replace(start, normal=normal, displacement=replace(start.displacement, fitted=(1, 3)))
    base, specular = (np.repeat(np.repeat(i, size // 16, 0), size // 16, 1) for i in (start.base_color, start.specular))
    return tessellated(replace(several, base_color=base, specular=specular))


def test_the_image_stays():
    given = shared()
    own = with_own_normals(given)
    assert own.mesh.own_normals is None and np.abs(own.normal - given.normal).max() > 0.05
    views = look_at(
        [[0.4, 0.8, -3.1], [1, -1, 3]], [0.02, 0, 0.01], [[2, 1.5, -2.5]] * 2, width=64, height=48, irradiance=np.pi
    )
    a, b, without = (
        Screen(m, mips="none").images(views, spp=16)[..., :3] for m in (given, own, replace(given, mesh=own.mesh))
    )
    off, unturned = (np.abs(x - a).mean() / a.mean() for x in (b, without))
    assert off < 0.005 < 0.02 < unturned
    np.testing.assert_allclose(np.linalg.norm(own.normal, axis=2), 1, atol=1e-5)


def test_there_and_back():
    """Turned back by exchanging the two meshes, the map is as it was, between the charts as well."""
    from mi_simplify.export.own_normals import _moved

    given = shared()
    own = with_own_normals(given)
    np.testing.assert_allclose(_moved(own.normal, own.mesh, given.mesh), given.normal, atol=2e-5)


def test_a_mesh_with_normals_of_its_own_is_left_alone():
    plain = tessellated(model())
    assert with_own_normals(plain) is plain


@pytest.mark.parametrize("side", [64, 256])
def test_levels_of_its_own_are_turned_too(side):
    given = shared()
    level = {"base_color": given.base_color, "specular": given.specular, "normal": given.normal[:side, :side]}
    turned = with_own_normals(replace(given, mips=(level,))).mips[0]
    assert turned["normal"].shape == (side, side, 3) and turned["base_color"] is given.base_color
    if side == 256:
        assert np.array_equal(turned["normal"], with_own_normals(given).normal)


def test_a_level_beyond_all_charts_stays():
    given = shared()
    level = {"base_color": given.base_color, "specular": given.specular, "normal": given.normal[:1, :1]}
    assert np.array_equal(with_own_normals(replace(given, mips=(level,))).mips[0]["normal"], level["normal"])


def test_a_rough_asset_from_the_command_line(tmp_path, capsys):
    """Files whose normals lie far from those that were fitted are right, down to the mip levels."""
    rough = bumpy_sphere(tmp_path, height=0.15)
    command = ["simplify", str(rough), "-n", "40", "-o", str(tmp_path / "out"), "--quiet", *TOY]
    command += [
        "--set",
        "initial.subdivisions=2",
        "--set",
        "initial.tessellations=[1,2]",
        "--set",
        "optimizer.steps=12",
    ]
    assert cli.main([*command, "--set", "latent.mips=custom"]) == 0, capsys.readouterr().err
    finest, turned = ((tmp_path / "out" / name).read_bytes() for name in ("mips/normal_0.png", "model_normal.png"))
    assert finest == turned != (tmp_path / "out" / "displacement" / "base_normal.png").read_bytes()
