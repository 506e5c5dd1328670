"""Our Mitsuba plugins are there whatever is imported first, and after every change of variant."""

import os
import subprocess
import sys

import mitsuba as mi
import pytest
from support.paths import ROOT

from mi_simplify import plugins
from mi_simplify.errors import RuntimeUnavailable
from mi_simplify.machine import runtime

#: Renders a square with both plugins.
RENDER = """
import numpy as np

def render():
    scene = mi.load_dict({
        'type': 'scene',
        'integrator': {'type': 'direct_edge'},
        'shape': {'type': 'rectangle', 'bsdf': {'type': 'ggx_gamma', 'base_color': .5, 'gamma': 1.}},
        'light': {'type': 'point', 'position': [0, 0, 3], 'intensity': np.pi * 9},
        'sensor': {
            'type': 'perspective', 'fov': 5,
            'to_world': mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
            'film': {'type': 'hdrfilm', 'width': 4, 'height': 4, 'rfilter': {'type': 'box'}},
        },
    })
    assert np.allclose(mi.render(scene, spp=4).numpy()[..., :3], .5, rtol=.01)
"""


def python(script: str) -> str:
    """Run a script in a fresh interpreter; its standard output."""
    root = str(ROOT)
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=env, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_plugins_survive_changes_of_the_variant():
    out = python(
        "import mi_simplify\nimport mitsuba as mi\n"
        + RENDER
        + """
for variant in ('llvm_ad_rgb', 'scalar_rgb', 'llvm_ad_rgb', 'llvm_ad_mono', 'scalar_rgb', 'llvm_ad_rgb'):
    mi.set_variant(variant)
    if variant == 'llvm_ad_rgb':
        render()
        assert type(mi.load_dict({'type': 'ggx_gamma'})).__module__ == 'mi_simplify.bsdfs.ggx_gamma'
        print('rendered')
        continue
    for name in ('ggx_gamma', 'direct_edge'):
        try:
            mi.load_dict({'type': name})
        except Exception as error:
            assert f"variant '{variant}' cannot be used: choose one of llvm_ad_rgb, cuda_ad_rgb" in str(error), error
        else:
            raise AssertionError(name)
"""
    )
    assert out.split() == ["rendered"] * 3


def test_classes_belong_to_the_variant_that_is_active():
    """As between LLVM and CUDA, here with a variant that needs no GPU put on the list."""
    python(
        """
import mi_simplify
from mi_simplify import plugins
import mitsuba as mi
plugins.VARIANTS += ('llvm_ad_mono',)
for variant in ('llvm_ad_rgb', 'llvm_ad_mono', 'llvm_ad_rgb'):
    mi.set_variant(variant)
    assert isinstance(mi.load_dict({'type': 'ggx_gamma'}), mi.BSDF), variant
    assert isinstance(mi.load_dict({'type': 'direct_edge'}), mi.Integrator), variant
"""
    )


@pytest.mark.parametrize(
    "first",
    [
        "import mitsuba as mi\nmi.set_variant('llvm_ad_rgb')\nimport mi_simplify",
        "import mitsuba as mi\nimport mi_simplify\nmi.set_variant('llvm_ad_rgb')",
        "import mi_simplify\nfrom mi_simplify.machine import runtime\nruntime.ensure_variant()\nimport mitsuba as mi",
        "from mi_simplify import plugins\nimport mitsuba as mi\nmi.set_variant('llvm_ad_rgb')",
    ],
)
def test_plugins_are_there_in_any_order_of_imports(first):
    # Where Mitsuba comes first nobody has chosen an LLVM yet: the environment hands over that of this process.
    python(first + RENDER + "render()")


def test_importing_sets_no_variant_and_loads_no_renderer():
    out = python(
        """
import sys
import mi_simplify
print('mitsuba' in sys.modules, 'drjit' in sys.modules)
import mitsuba as mi
print(mi.variant())
"""
    )
    assert out.split() == ["False", "False", "None"]


def test_variants_without_derivatives_are_refused_with_the_list(monkeypatch):
    plugins.require_ad_variant()
    monkeypatch.setattr(mi, "variant", lambda: "scalar_rgb")
    with pytest.raises(RuntimeUnavailable, match="variant 'scalar_rgb' cannot be used: choose one of llvm_ad_rgb, cu"):
        plugins.require_ad_variant()
    with pytest.raises(RuntimeUnavailable, match="'llvm_ad_spectral' is not supported; use one of llvm_ad_rgb, cuda"):
        runtime.ensure_variant("llvm_ad_spectral")
    assert plugins.VARIANTS == runtime.VARIANTS
