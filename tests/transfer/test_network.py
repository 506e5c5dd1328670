"""The network: learns, is exported, runs by onnxruntime; without PyTorch these tests are skipped."""

import numpy as np
import pytest
from support.folding import folding

from mi_simplify.errors import AssetError, ConfigError
from mi_simplify.transfer.dataset import bake
from mi_simplify.transfer.judge import judge
from mi_simplify.transfer.network import Network, Training, make_unet, train

pytest.importorskip("torch", reason="no PyTorch: install the extra 'transfer'")
pytest.importorskip("onnxruntime", reason="no onnxruntime: install the extra 'transfer'")
pytest.importorskip("onnxscript", reason="no onnxscript: install the extra 'transfer'")


@pytest.fixture(scope="module")
def data():
    return bake(folding(), 16, n_directions=64)


def test_the_paper_s_size_has_as_many_parameters_as_the_paper():
    assert sum(p.numel() for p in make_unet("paper", 256, 16).parameters()) == pytest.approx(11.8e6, rel=0.15)
    assert sum(p.numel() for p in make_unet("small", 64, 16).parameters()) < 1e6


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_network_beats_no_shadows_and_survives_its_file(data, tmp_path):
    path = tmp_path / "net.onnx"
    done = train(data, path, Training(epochs=10))
    assert done["epochs"] == 10 and done["loss"] > 0
    network = Network(path)
    figures = judge(data, {"network": network}, size=48)
    assert figures["network"]["l1"] < figures["unshadowed"]["l1"]
    with pytest.raises(AssetError, match="images of 16² pixels expected by this network, these have 8²"):
        network(np.zeros((1, 64, 3), np.float32), np.zeros((1, 64, 3), np.float32))


def test_what_cannot_be_is_said(data, tmp_path):
    with pytest.raises(AssetError, match="nothing to resume"):
        train(data, tmp_path / "none.onnx", Training(), resume=True)
    with pytest.raises(ConfigError, match="one of small, paper expected"):
        make_unet("large", 16, 16)
    (tmp_path / "bad.onnx").write_bytes(b"bad")
    with pytest.raises(AssetError, match="a network of 'transfer train' expected"):
        Network(tmp_path / "bad.onnx")
