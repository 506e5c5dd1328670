"""
Textures encoded by Basis Universal's own program, ``basisu``, with mip levels that we have made.

Of ETC1S all levels share codebooks: they are encoded as the images of one ``.basis`` file, which KTX2 stores in another
order. UASTC is encoded level by level.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import OutputError
from .ktx2 import Payload, encode_ktx2
from .png import encode_png

PROGRAM = "basisu"

#: Quality from which UASTC is taken: 8 bits a texel, where ETC1S has about 1.
LEAST_UASTC = 95


def require_basisu() -> str:
    """
    Where the encoder is.

    Raises
    ------
    OutputError
        It is not on the PATH.
    """
    found = shutil.which(PROGRAM)
    if found is None:
        raise OutputError(
            f"KTX2 textures are encoded by the program '{PROGRAM}' of Basis Universal, which is not on the PATH: "
            "install it (github.com/BinomialLLC/basis_universal), or choose --textures webp"
        )
    return found


def encode_basis(levels: Sequence[np.ndarray], quality: int, *, data: bool) -> bytes:
    """
    Mip levels as a KTX2 file for KHR_texture_basisu.

    Parameters
    ----------
    levels : sequence of ndarray, shape (H, W, 3 or 4), uint8
        The finest first, each half as large as the one before, sides of the finest multiples of four.
    quality : int
        1 to 100: of ETC1S, from :data:`LEAST_UASTC` on UASTC.
    data : bool
        The channels are no sRGB colours.

    Raises
    ------
    OutputError
        The sides are no multiples of four, or the encoder is missing or fails.
    """
    program = require_basisu()
    height, width = levels[0].shape[:2]
    if height % 4 or width % 4:
        raise OutputError(f"KTX2 textures of {width} x {height} texels: glTF wants multiples of 4; choose another size")
    has_alpha = levels[0].shape[2] == 4
    options = ["-no_multithreading", *(["-linear"] if data else []), *([] if has_alpha else ["-no_alpha"])]
    with tempfile.TemporaryDirectory() as name:
        folder, files = Path(name), []
        for k, level in enumerate(levels):
            files.append(folder / f"{k:02}.png")
            files[-1].write_bytes(encode_png(level))
        if quality >= LEAST_UASTC:
            payload = _uastc(program, files, options, has_alpha)
        else:
            payload = _etc1s(program, files, [*options, "-q", str(max(1, round(2.55 * quality)))], has_alpha)
    return encode_ktx2(payload, width, height, srgb=not data)


def _uastc(program: str, files: list[Path], options: list[str], has_alpha: bool) -> Payload:
    """Every level as a KTX2 file of its own, whose one level is compressed by Zstandard."""
    levels = []
    for file in files:
        out = file.with_suffix(".ktx2")
        more = ["-ktx2", "-ktx2_zstandard_level", "18", "-uastc", "-uastc_level", "2", "-uastc_rdo_l", "0.5"]
        content = _run(program, [*options, *more, "-uastc_rdo_m"], [file], out)
        offset, stored, length = struct.unpack_from("<3Q", content, 80)
        levels.append((content[offset : offset + stored], length))
    return Payload(True, has_alpha, levels)


def _etc1s(program: str, files: list[Path], options: list[str], has_alpha: bool) -> Payload:
    """
    All levels as images of one .basis file: ``basis_file_header`` and ``basis_slice_desc`` of basisu_file_headers.h.
    """
    content = _run(program, [*options, "-tex_type", "2d"], files, files[0].with_suffix(".basis"))
    n_slices = int.from_bytes(content[14:17], "little")
    n_endpoints, at_endpoints = struct.unpack_from("<HI", content, 39)
    n_selectors, at_selectors = struct.unpack_from("<HI", content, 48)
    endpoints = content[at_endpoints:][: int.from_bytes(content[45:48], "little")]
    selectors = content[at_selectors:][: int.from_bytes(content[54:57], "little")]
    at_tables, tables_size, at_slices = struct.unpack_from("<3I", content, 57)
    tables = content[at_tables : at_tables + tables_size]
    slices: list[list[bytes]] = [[] for _ in files]
    for k in range(n_slices):
        row = at_slices + 23 * k
        image = int.from_bytes(content[row : row + 3], "little")
        offset, size = struct.unpack_from("<2I", content, row + 13)
        slices[image].append(content[offset : offset + size])  # colour, then opacity
    head = struct.pack("<2H4I", n_endpoints, n_selectors, len(endpoints), len(selectors), len(tables), 0)
    for parts in slices:
        alpha = (len(parts[0]), len(parts[1])) if len(parts) > 1 else (0, 0)
        head += struct.pack("<5I", 0, 0, len(parts[0]), *alpha)
    return Payload(
        False, has_alpha, [(b"".join(parts), 0) for parts in slices], head + endpoints + selectors + tables
    )  # fmt: skip


def _run(program: str, options: list[str], files: list[Path], out: Path) -> bytes:
    """What the program makes of images."""
    command = [program, *options, "-output_file", str(out), *map(str, files)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=out.parent)
    if done.returncode or not out.is_file():
        lines = (done.stderr or done.stdout).strip().splitlines()
        raise OutputError(f"{program} failed: {lines[-1] if lines else done.returncode}; choose --textures webp")
    return out.read_bytes()
