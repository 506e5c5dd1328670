"""
The network: transfer from geometry images, trained with PyTorch and written as ONNX. Nothing else imports PyTorch.
"""

from __future__ import annotations

import functools
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AssetError, ConfigError, RuntimeUnavailable
from ..machine.files import write_atomic
from ..progress import Progress, ProgressCallback, silent
from .cast import unshadowed
from .dataset import Dataset

#: Channels at each halving of the image, from full resolution down.
WIDTHS = {"small": (16, 32, 64, 96), "paper": (40, 80, 160, 320, 480)}

#: Levels of larger sides have no values of their own for each pixel, which would outweigh all the convolutions.
MOST_PLACES = 64


@dataclass(frozen=True)
class Training:
    """
    How a network is trained.

    Parameters
    ----------
    size : str
        Of :data:`WIDTHS`; ``paper`` has about as many parameters as the paper's and wants a GPU.
    epochs : int
        At most.
    minutes : float
        At most; the epoch that is under way is finished.
    batch, lr : int, float
        Frames a step, and Adam's step, which falls to 0 along a cosine.
    patience : int
        Stop after so many epochs without a lower loss on the tenth of the training frames that is set aside.
    seed : int
    """

    size: str = "small"
    epochs: int = 60
    minutes: float = 25.0
    batch: int = 5
    lr: float = 2e-3
    patience: int = 15
    seed: int = 0


def _torch() -> Any:
    try:
        import torch
    except ImportError as error:
        raise RuntimeUnavailable(f"training needs PyTorch: pip install 'mi-simplify[transfer]' ({error})") from None
    return torch


def make_unet(size: str, n: int, n_coefficients: int) -> Any:
    """
    A ``torch.nn.Module``: images (B, 6, n, n) of positions and normals to (B, K, n, n).

    Encoder and decoder of residual blocks (two 3 × 3 convolutions, batch normalisation, ReLU), halved by strided
    convolutions, doubled by transposed ones, with skip connections between (Ronneberger et al. 2015). Ours: what goes
    in and out is relative to its mean over the training frames, pixel by pixel, since a face moves little beside its
    own size; and each level of at most 64² pixels adds learned values of its own to every pixel (``place``), because a
    convolution does not know which part of the surface it is looking at.
    """
    if size not in WIDTHS:
        raise ConfigError(f"size: one of {', '.join(WIDTHS)} expected, got '{size}'")
    if n % 2 ** (len(WIDTHS[size]) - 1):
        raise ConfigError(f"n: a multiple of {2 ** (len(WIDTHS[size]) - 1)} expected, got {n}; bake it again")
    torch: Any = _torch()
    nn: Any = torch.nn

    class Block(nn.Module):
        def __init__(self, width: int):
            super().__init__()
            layers = []
            for _ in range(2):  # slow averages: a batch of five is few
                layers += [nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width, momentum=0.02)]
            self.inside = nn.Sequential(*layers[:2], nn.ReLU(), *layers[2:])

        def forward(self, x: Any) -> Any:
            return torch.relu(x + self.inside(x))

    class UNet(nn.Module):
        def __init__(self, widths: tuple[int, ...]):
            super().__init__()
            pairs = list(zip(widths[:-1], widths[1:], strict=True))
            self.register_buffer("mean", torch.zeros(6, n, n))
            self.register_buffer("spread", torch.ones(6, 1, 1))
            self.register_buffer("mean_out", torch.zeros(n_coefficients, n, n))
            self.register_buffer("spread_out", torch.ones(()))
            self.first = nn.Conv2d(6, widths[0], 3, padding=1)
            sides = [(n // 2**level,) * 2 for level in range(len(widths))]
            sides = [side if side[0] <= MOST_PLACES else (1, 1) for side in sides]
            values = [0.1 * torch.randn(width, *side) for width, side in zip(widths, sides, strict=True)]
            self.place = nn.ParameterList(map(nn.Parameter, values))
            self.down = nn.ModuleList([nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in pairs])
            self.encode = nn.ModuleList([Block(b) for _, b in pairs])
            self.up = nn.ModuleList([nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in pairs])
            self.decode = nn.ModuleList([Block(a) for a, _ in pairs])
            self.last = nn.Conv2d(widths[0], n_coefficients, 3, padding=1)

        def normalise(self, x: Any, y: Any) -> None:
            """Take means and spreads from images of the training frames."""
            self.mean.copy_(x.mean(0))
            self.spread.copy_((x - self.mean).square().mean((0, 2, 3)).sqrt().clamp(min=1e-6)[:, None, None])
            self.mean_out.copy_(y.mean(0))
            self.spread_out.copy_((y - self.mean_out).square().mean().sqrt().clamp(min=1e-6))

        def forward(self, x: Any) -> Any:
            x = torch.relu(self.first((x - self.mean) / self.spread) + self.place[0])
            skips = []
            for down, place, encode in zip(self.down, self.place[1:], self.encode, strict=True):
                skips.append(x)
                x = encode(torch.relu(down(x) + place))
            for up, decode in reversed(list(zip(self.up, self.decode, strict=True))):
                x = decode(up(x) + skips.pop())
            return self.mean_out + self.spread_out * self.last(x)

    return UNet(WIDTHS[size])


def train(
    data: Dataset, out: str | Path, training: Training, progress: ProgressCallback = silent, *, resume: bool = False
) -> dict[str, Any]:
    """
    Train a network on what rays lose against the closed form without shadows, and write it as ONNX.

    The loss is the mean absolute error. Learning the difference, not the coefficients themselves, is ours: the network
    need not learn what the normals say already.

    Parameters
    ----------
    data : Dataset
    out : str or Path
        The ``.onnx`` file; beside it ``.pt`` keeps what a resumed training needs.
    training : Training
    progress : callable
    resume : bool
        Go on with the training that lies there.

    Returns
    -------
    dict
        ``epochs``, ``seconds``, ``loss`` and ``parameters``.

    Raises
    ------
    RuntimeUnavailable
        PyTorch is not installed.
    AssetError
        There is nothing to resume.
    """
    torch = _torch()
    n, k = data.n, data.transfer.shape[2]
    torch.manual_seed(training.seed)
    net = make_unet(training.size, n, k)
    order = round(k**0.5) - 1
    lost = unshadowed(data.normals, order, data.albedo) - data.transfer
    x, y = (torch.from_numpy(images) for images in (_images(data.positions, data.normals, n), _planes(lost, n)))
    net.normalise(x[data.training], y[data.training])
    scale = float(net.spread_out)
    rng = np.random.default_rng(training.seed)
    frames = data.training
    aside = frames[:: max(2, len(frames) // max(1, len(frames) // 10))]
    used = np.setdiff1d(frames, aside)
    adam = torch.optim.Adam(net.parameters(), lr=training.lr)
    state_path = Path(out).with_suffix(".pt")
    epoch, best, since, best_state, spent = 0, np.inf, 0, net.state_dict(), 0.0
    history: list[float] = []
    if resume:
        if not state_path.exists():
            raise AssetError(f"{state_path}: nothing to resume there; leave out --resume")
        saved = torch.load(state_path, weights_only=False)
        net.load_state_dict(saved["net"])
        adam.load_state_dict(saved["adam"])
        epoch, best, since, best_state, spent = (saved[key] for key in ("epoch", "best", "since", "kept", "spent"))
        rng.bit_generator.state = saved["rng"]
        history = saved["history"]
    start = time.monotonic()
    while epoch < training.epochs and since < training.patience:
        done = spent + time.monotonic() - start
        if done > 60 * training.minutes:
            break
        share = max(epoch / training.epochs, done / (60 * training.minutes))
        for group in adam.param_groups:
            group["lr"] = training.lr * (0.5 + 0.5 * np.cos(np.pi * min(1.0, share)))
        net.train()
        order_of = rng.permutation(used)
        for batch in np.array_split(order_of, max(1, len(used) // training.batch)):
            loss = (net(x[batch]) - y[batch]).abs().mean() / scale
            adam.zero_grad()
            loss.backward()
            adam.step()
        net.eval()
        with torch.no_grad():
            value = float(np.mean([float((net(x[[f]]) - y[[f]]).abs().mean()) for f in aside]))
        epoch, since = epoch + 1, since + 1
        if value < best:
            best, since = value, 0
            best_state = {key: v.clone() for key, v in net.state_dict().items()}
        history.append(value)
        progress(Progress("train", epoch, training.epochs, loss=value))
        if epoch % 10 == 0:
            saved = {
                "net": net.state_dict(), "adam": adam.state_dict(), "epoch": epoch, "best": best, "since": since,
                "kept": best_state, "spent": spent + time.monotonic() - start, "rng": rng.bit_generator.state,
                "history": history,
            }  # fmt: skip
            write_atomic(state_path, functools.partial(torch.save, saved))
    net.load_state_dict(best_state)
    net.eval()
    facts = {"n": n, "albedo": data.albedo, "order": order, "history": history, **asdict(training)}
    _export(net, out, n, facts)
    parameters = sum(p.numel() for p in net.parameters())
    return {
        "epochs": epoch,
        "seconds": spent + time.monotonic() - start,
        "loss": best,
        "parameters": parameters,
    }


def _export(net: Any, out: str | Path, n: int, facts: dict[str, Any]) -> None:
    """Write ONNX; what :class:`Network` has to know stands in its metadata."""
    torch = _torch()
    import onnx

    def write(path: Path) -> None:
        options: dict[str, Any] = {"input_names": ["images"], "output_names": ["lost"], "external_data": False}
        torch.onnx.export(net, (torch.zeros(1, 6, n, n),), str(path), dynamo=True, verbose=False, **options)
        model = onnx.load(str(path))
        onnx.helper.set_model_props(model, {"mi_simplify": json.dumps(facts)})
        onnx.save(model, str(path))

    write_atomic(out, write)


class Network:
    """
    A trained network, run by onnxruntime.

    Parameters
    ----------
    path : str or Path
        The ``.onnx`` file.

    Raises
    ------
    RuntimeUnavailable
        onnxruntime is not installed.
    AssetError
        The file is missing or not one of ours.
    """

    def __init__(self, path: str | Path):
        try:
            import onnxruntime
        except ImportError as error:
            raise RuntimeUnavailable(
                f"networks need onnxruntime: pip install 'mi-simplify[transfer]' ({error})"
            ) from None
        try:
            self._session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
            facts = json.loads(self._session.get_modelmeta().custom_metadata_map["mi_simplify"])
        except Exception as error:
            line = (str(error).splitlines() or ["?"])[0][:200]
            raise AssetError(f"{path}: a network of 'transfer train' expected, it cannot be read ({line})") from None
        self.n, self.order = int(facts["n"]), int(facts["order"])
        self._albedo = float(facts["albedo"])
        self.history: list[float] = [float(x) for x in facts["history"]]  # loss on frames set aside, by epoch

    def __call__(self, positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """
        Transfer, shape (T, n², K), from positions and normals (T, n², 3) in the frame of a :class:`.dataset.Dataset`.

        Raises
        ------
        AssetError
            The images have another resolution than those it was trained on.
        """
        if positions.shape[1] != self.n**2:
            side = round(positions.shape[1] ** 0.5)
            raise AssetError(f"images of {self.n}² pixels expected by this network, these have {side}²; bake them anew")
        images = _images(positions, normals, self.n)
        lost = np.concatenate([self._session.run(None, {"images": images[k : k + 1]})[0] for k in range(len(images))])
        flat = lost.reshape(len(lost), lost.shape[1], -1).transpose(0, 2, 1)
        return unshadowed(normals, self.order, self._albedo) - flat


def _images(positions: np.ndarray, normals: np.ndarray, n: int) -> np.ndarray:
    """(T, 6, n, n), float32."""
    return np.concatenate([_planes(positions, n), _planes(normals, n)], axis=1)


def _planes(values: np.ndarray, n: int) -> np.ndarray:
    """(T, n², C) as (T, C, n, n)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(len(values), n, n, -1), 3, 1), np.float32)
