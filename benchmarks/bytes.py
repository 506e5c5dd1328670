"""
How many bytes a result takes at which likeness: ways to pack one fitted model, judged against its asset.

    .venv/bin/python benchmarks/bytes.py ../shared/assets/skull/skull.obj:1000 --set preset=fast

GPU: bytes of the textures in graphics memory with their mip levels, four a texel, or one where KTX2 is transcoded to
blocks (BC7). KTX2 needs the program `basisu`; its rows are left out where it is missing. `max-bytes` are shares of the
file of PNGs; what was chosen stands below the table.
"""

from __future__ import annotations

import argparse
import dataclasses
import shutil
from pathlib import Path

import mi_simplify as ms
from mi_simplify.config.glb import GlbSettings
from mi_simplify.errors import OutputError
from mi_simplify.formats.gltf.write import write_glb
from mi_simplify.formats.packing import pack_textures
from mi_simplify.formats.pixels.basisu import PROGRAM
from mi_simplify.jobs.byte_budget import within_bytes
from mi_simplify.judging.evaluate import Judging
from mi_simplify.judging.renderers import RENDERERS
from mi_simplify.model.model import Model
from mi_simplify.subjects import open_subject

PACKINGS = {
    "PNG": GlbSettings(),
    "PNG, meshopt": GlbSettings(compress="meshopt"),
    "WebP lossless, meshopt": GlbSettings(compress="meshopt", textures="webp", quality=100),
    "WebP 90, data 95, meshopt": GlbSettings(compress="meshopt", textures="webp", data_quality=95),
    "WebP 95, data 90, meshopt": GlbSettings(compress="meshopt", textures="webp", quality=95, data_quality=90),
    "WebP 80, data 80, meshopt": GlbSettings(compress="meshopt", textures="webp", quality=80, data_quality=80),
    "KTX2 UASTC, meshopt": GlbSettings(compress="meshopt", textures="ktx2", quality=95, data_quality=95),
    "KTX2 ETC1S, meshopt": GlbSettings(compress="meshopt", textures="ktx2", quality=80, data_quality=80),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("assets", nargs="+", help="each with its budget: FILE:TRIANGLES")
    parser.add_argument("--shares", default="4,8,16", help="parts of the file of PNGs that --max-bytes is asked for")
    parser.add_argument("--renderer", choices=RENDERERS, default="mitsuba", help="what judges")
    parser.add_argument("--out", type=Path, default=Path("out") / "bytes")
    parser.add_argument("--set", nargs="*", default=[], help="configuration keys")
    args = parser.parse_args()
    for named in args.assets:
        name, triangles = named.rsplit(":", 1)
        config = ms.load_config(None, [f"asset={name}", f"initial.triangles={triangles}", *args.set])
        shares = [float(x) for x in args.shares.split(",")]
        table(config, shares, args.out / Path(name.replace(":", "_")).stem, args.renderer)


def table(config: ms.Config, shares: list[float], out: Path, renderer: str) -> None:
    """One asset: its files, and a row for each."""
    ms.ensure_variant(config.variant)
    subject = open_subject(config)
    config = subject.config
    guess, _ = subject.guess()
    model = guess
    if config.optimizer.steps:
        model = ms.fit(guess, subject.reference(), config).model
    model = subject.frame.restored(model)
    out.mkdir(parents=True, exist_ok=True)
    packings, notes = dict(PACKINGS), []
    if shutil.which(PROGRAM) is None:
        packings = {name: packing for name, packing in packings.items() if packing.textures != "ktx2"}
    full = write_glb(model, out / "PNG.glb").stat().st_size
    for share in shares:
        try:
            packing = within_bytes(model, GlbSettings(max_bytes=int(full / share)))
        except OutputError as error:
            notes.append(str(error))
            continue
        packings[f"max-bytes, 1/{share:g}"] = packing.settings
        notes.append(packing.note)
    candidates, rows = {}, {}
    for name, packing in packings.items():
        file = write_glb(model, out / f"{name.replace('/', '_')}.glb", settings=packing)
        candidates[name] = ms.load_asset(file)
        rows[name] = [f"{file.stat().st_size / 1000:.1f}", f"{file.stat().st_size / full:.3f}", gpu(model, packing)]
    judged = subject.judge(candidates, dataclasses.replace(Judging.of(config), renderer=renderer))
    print(f"\n{subject.geometry.name}, {model.n_triangles} triangles, atlas of {model.base_color.shape[0]}²\n")
    print("| | kB | share | textures on the GPU [kB] | PSNR [dB] | FLIP |\n|---|---|---|---|---|---|")
    for name, row in rows.items():
        figures = judged.figures["candidates"][name]
        print(f"| {name} | " + " | ".join([*row, f"{figures['psnr']:.2f}", f"{figures['flip']:.4f}"]) + " |")
    print("\n" + "\n".join(f"- {note}" for note in notes), flush=True)


def gpu(model: Model, packing: GlbSettings) -> str:
    """Textures in graphics memory [kB]."""
    a_texel = 1 if packing.textures == "ktx2" else 4
    texels = sum(image.size[0] * image.size[1] for image in pack_textures(model, packing).images.values())
    return f"{texels * a_texel * 4 / 3 / 1000:.0f}"


if __name__ == "__main__":
    main()
