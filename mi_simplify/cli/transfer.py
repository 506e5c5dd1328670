"""
The commands of precomputed radiance transfer: bake a sequence, train a network on it, predict with it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .console import display, prepare
from .options import OUT, OVERWRITE, QUIET, default_folder


@click.group()
def transfer() -> None:
    """
    Soft self-shadows of things that deform: cast by rays, learned by a network.
    """


@transfer.command()
@click.argument("source")
@click.option("--out", "-o", metavar="NPZ", required=True, help="The file that holds all frames.")
@click.option("--size", "n", type=click.IntRange(4, 1024), default=64, show_default=True, help="Image side [px].")
@click.option("--frames", type=click.IntRange(2, 100_000), default=500, show_default=True, help="Poses.")
@click.option("--directions", type=click.IntRange(1, 65536), default=256, show_default=True, help="Rays of a vertex.")
@click.option("--order", type=click.IntRange(0, 3), default=3, show_default=True, help="Highest band.")
@click.option("--bounces", type=click.IntRange(0, 2), default=0, show_default=True, help="Interreflections.")
@click.option("--albedo", type=click.FloatRange(0, 1), default=0.8, show_default=True, help="Diffuse reflectance.")
@click.option("--close-holes", is_flag=True, help="Close all borders but the longest.")
@click.option("--part", metavar="NAME", help="The part of a model that has several.")
@click.option("--vertices", type=click.IntRange(min=3), help="First vertices of a face's file to keep.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of cloth and expressions.")
@QUIET
def bake(source, out, n, frames, part, vertices, seed, quiet, directions, order, bounces, albedo, close_holes) -> None:
    """
    Cast the transfer of SOURCE: 'cloth', sample:fish or an animated model file, a folder of OBJ or PLY frames, or an
    npz file of blend shapes.
    """
    prepare(None)
    from ..record.output import check_writable
    from ..transfer.dataset import bake as bake_sequence
    from ..transfer.sequences.opening import open_sequence

    check_writable(out)
    sequence = open_sequence(source, frames, part=part, n_vertices=vertices, seed=seed)
    with display(quiet) as progress:
        data = bake_sequence(
            sequence, n, progress,
            close_holes=close_holes, order=order, n_directions=directions, bounces=bounces, albedo=albedo,
        )  # fmt: skip
    data.save(out)
    if not quiet:
        for note in sequence.notes:
            print("note:", note)
        print(", ".join(f"{name} {value:.4g}" for name, value in data.figures.items()))
        print(out)


@transfer.command()
@click.argument("data")
@click.option("--out", "-o", metavar="ONNX", required=True, help="The trained network.")
@click.option("--model", default="small", show_default=True, help="small, or paper with about 11.8 million parameters.")
@click.option("--epochs", type=click.IntRange(1), default=60, show_default=True, help="At most.")
@click.option("--minutes", type=click.FloatRange(0, min_open=True), default=25.0, show_default=True, help="At most.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of weights and order.")
@click.option("--resume", is_flag=True, help="Go on with a training that was stopped.")
@QUIET
def train(data, out, model, epochs, minutes, seed, resume, quiet) -> None:
    """
    Train a network on DATA, a file of 'transfer bake'. Needs PyTorch, the extra [transfer].
    """
    prepare(None)
    from ..record.output import check_writable
    from ..transfer.dataset import load_dataset
    from ..transfer.network import Training
    from ..transfer.network import train as train_network

    check_writable(out)
    settings = Training(size=model, epochs=epochs, minutes=minutes, seed=seed)
    with display(quiet) as progress:
        done = train_network(load_dataset(data), out, settings, progress, resume=resume)
    if not quiet:
        print(f"{done['parameters']:,} parameters, {done['epochs']} epochs in {done['seconds']:.0f} s")
        print(f"loss {done['loss']:.3g} on frames set aside")
        print(out)


@transfer.command()
@click.argument("data")
@click.argument("network", required=False)
@click.option("--out", "-o", metavar="NPZ", help="Also write the network's coefficients of the held-out frames.")
def predict(data, network, out) -> None:
    """
    Predict the held-out frames of DATA by NETWORK and by the linear model, and measure both against the rays.
    """
    prepare(None)
    import numpy as np

    from ..machine.files import write_atomic
    from ..transfer.dataset import load_dataset
    from ..transfer.judge import judge
    from ..transfer.linear import fit_linear
    from ..transfer.network import Network

    baked = load_dataset(data)
    models: dict[str, Any] = {"linear": fit_linear(baked)}
    if network:
        models["network"] = Network(network)
    for name, figures in judge(baked, models).items():
        print(f"{name:10}  L1 {figures['l1']:.5f}  PSNR {figures['psnr']:.2f} dB")
    if out and network:
        frames = baked.held_out
        coefficients = models["network"](baked.positions[frames], baked.normals[frames])
        write_atomic(Path(out), lambda p: np.savez(p, frames=frames, transfer=coefficients))
        print(out)


@transfer.command()
@click.argument("config")
@OUT
@OVERWRITE
@QUIET
def run(config, out, overwrite, quiet) -> None:
    """
    Bake, train, judge and report what the YAML file CONFIG describes; a run that was stopped goes on.
    """
    from ..config.commands.transfer import load_transfer

    wanted = load_transfer(config)
    prepare(None)
    from ..transfer.run import PAGE, run_transfer

    folder = Path(out or default_folder(config))
    with display(quiet) as progress:
        figures = run_transfer(wanted, folder, progress, overwrite=overwrite)
    if not quiet:
        for name, own in figures["models"].items():
            print(f"{name:10}  L1 {own['l1']:.5f}  PSNR {own['psnr']:.2f} dB")
        print(folder / PAGE)


@transfer.command()
@click.argument("data")
@click.argument("network")
@click.option("--out", "-o", metavar="HTML", required=True, help="The page.")
@click.option("--frames", type=click.IntRange(1, 200), default=20, show_default=True, help="Held-out frames in it.")
def show(data, network, out, frames) -> None:
    """
    Write a page that plays held-out frames of DATA, from rays, NETWORK and the linear model, under a sky that turns.
    """
    prepare(None)
    from ..record.output import check_writable
    from ..transfer.dataset import load_dataset
    from ..transfer.linear import fit_linear
    from ..transfer.network import Network
    from ..transfer.page import write_page
    from ..transfer.run import measured

    check_writable(out)
    baked = load_dataset(data)
    model, linear = Network(network), fit_linear(baked)
    figures = measured(baked, model, linear) | {"network_bytes": Path(network).stat().st_size}
    write_page(out, baked, {"network": model, "linear": linear}, figures, frames, Path(out).stem)
    print(out)
