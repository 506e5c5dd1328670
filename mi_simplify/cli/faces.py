"""
The command that fits a face.
"""

from __future__ import annotations

from pathlib import Path

import click

from .console import display, prepare
from .options import OUT, OVERWRITE, QUIET, default_folder


@click.command()
@click.argument("config")
@OUT
@OVERWRITE
@QUIET
def face(config, out, overwrite, quiet) -> None:
    """
    Fit a morphable face to portraits with landmarks, as the YAML file CONFIG says.
    """
    from ..config.commands.face import load_face

    wanted = load_face(config)
    prepare(None)
    from ..jobs.faces.job import RESULT, face_job

    folder = Path(out or default_folder(config))
    with display(quiet) as progress:
        figures = face_job(wanted, folder, progress, overwrite=overwrite)
    if not quiet:
        for name, row in figures["candidates"].items():
            print(f"{name:10}  PSNR {row['psnr']:5.2f} dB  silhouette error {row['silhouette_error']:.4f}")
        print(
            f"scale {figures['run']['scale']:.4g}, landmarks alone off by {figures['run']['landmark_error']:.2f} pixels"
        )
        print(folder / RESULT)
