"""
Wavefront MTL material libraries as metallic-roughness materials.

Read: ``Kd``, ``map_Kd``, ``d``, ``Tr``, ``map_d``, ``Ke``, ``map_Ke`` and the physically based extension ``Pr``,
``Pm``, ``map_Pr``, ``map_Pm``, ``norm``; of texture options ``-o``, ``-s`` and ``-clamp``. ``Ks`` and ``Ns`` are
left out with a line (docs/conventions.md): the Phong lobe has no exact counterpart. ``Kd`` is an sRGB
colour, as three.js and most exporters to glTF take it, and a ``map_Kd`` replaces it; ``Ke`` is radiance, linear, and
multiplies ``map_Ke`` where it is not black.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...model.asset import Material
from ...model.color import srgb_to_linear
from ...model.light.emission import ambient_of, own_emission
from ..images import constant, is_normal_map, join_channels, opacity, rgb, to_float, unit_normals
from ..mapping import Mapping, Mappings
from ..resources import MissingFile, Resources, as_utf8, printable, read_bytes
from ..textures import HOLDS_AMBIENT

#: Arguments that each option of a texture statement takes at most; numbers only for ``-o -s -t``.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-clamp": 1, "-bm": 1,
    "-imfchan": 1, "-type": 1, "-cc": 1,
}  # fmt: skip

#: Which texture of a material a statement becomes, or joins; the others are normal maps.
_TEXTURES = {
    "map_kd": "base_color", "map_d": "base_color", "map_pr": "specular", "map_pm": "specular", "map_ke": "emission",
}  # fmt: skip

#: Statements of the format that have no counterpart here and are worth a line where they say something.
_LEFT_OUT = {"map_ks": "specular colour", "disp": "displacement", "decal": "decal"}


def read_mtl(name: str, resources: Resources) -> dict[str, tuple[Material, tuple[Mapping, ...]]]:
    """
    Materials of a library by name, and the coordinates that their lookups number, for texture coordinates with their
    origin at the top left; empty, with a note, where the library is missing.

    Parameters
    ----------
    name : str
        The argument of ``mtllib``: one file name, or several.

    Raises
    ------
    AssetError
        A texture is missing or cannot be read, or a file lies outside the model's folder.
    """
    paths = []
    try:
        paths = [resources.find(name, "material library")]
    except MissingFile:
        for part in name.split():
            try:
                paths.append(resources.find(part, "material library"))
            except MissingFile:
                resources.note(
                    f"material library '{printable(part)}' does not exist; its materials are the default grey"
                )
    statements: dict[str, dict[str, str]] = {}
    places: dict[str, tuple[Path, np.ndarray | None]] = {}
    for path in paths:
        current: dict[str, str] = {}
        data = as_utf8(read_bytes(path, f"{resources.model.name}: material library"))
        ours = re.search(f"# {HOLDS_AMBIENT}: ([^\n]*)\n".encode(), data[:400])
        ambient = None if ours is None else ambient_of(ours[1].decode("utf-8", "replace"))
        for line in data.decode("utf-8", "replace").replace("\\\n", " ").splitlines():
            words = line.split(None, 1)
            key, value = (words + ["", ""])[:2]
            key, value = key.lower(), value.strip()
            if key == "newmtl":
                current = statements.setdefault(value, {})
                places[value] = path, ambient
            elif key and not key.startswith("#"):
                current[key] = value
    phong = [name for name, values in statements.items() if any(_numbers(values.get("ks")))]
    if phong:
        resources.note(f"specular colour (Ks) of material {_listed(phong)} was left out: gloss is read from Pr and Pm")
    out = {}
    for name, values in statements.items():
        path, ambient = places[name]
        library = _Library(resources, path)
        material = _material(name, values, library)
        if ambient is not None and len(ambient) == 1:
            material = own_emission(material, ambient)
        out[name] = material, library.mappings.places
    return out


class _Library:
    """A library's file, where the names in it are looked for first; of one material, where its textures are."""

    def __init__(self, resources: Resources, path: Path):
        self._resources, self._path = resources, path
        self.mappings = Mappings()

    def image(self, uri: str) -> np.ndarray:
        return self._resources.image(uri, self._path)

    def note(self, line: str) -> None:
        self._resources.note(line)


def _material(name: str, values: dict[str, str], library: _Library) -> Material:
    color_map = _texture(values, "map_kd", library)
    numbers = _numbers(values.get("kd"))
    if color_map is not None:
        color = to_float(rgb(color_map), srgb=True)
    elif numbers:
        color = srgb_to_linear(constant(*(numbers * 3)[:3] if len(numbers) < 3 else numbers[:3]))
    else:
        color = Material().base_color[..., :3]
    alpha, mode = _opacity(name, values, library)
    roughness = _scalar(values, "pr", "map_pr", 0.5, library)
    metallic = _scalar(values, "pm", "map_pm", 0.0, library)
    for key, meaning in _LEFT_OUT.items():
        if key in values:
            library.note(f"{meaning} texture of material '{name}' ({key}) was left out")
    normal, emission = _normal_map(name, values, library), _emission(values, library)
    return Material(
        name=name,
        base_color=join_channels(color, alpha),
        specular=join_channels(constant(0), roughness, metallic),
        normal=normal,
        alpha_mode=mode,
        emission=emission,
        lookups=library.mappings.lookups,
    )


def _emission(values: dict[str, str], library: _Library) -> np.ndarray | None:
    """Linear radiance, shape (H, W, 3); None for none."""
    numbers = _numbers(values.get("ke"))
    factor = np.maximum(np.array((numbers * 3)[:3] if len(numbers) < 3 else numbers[:3], np.float32), 0)
    factor = factor if len(factor) else np.zeros(3, np.float32)
    image = _texture(values, "map_ke", library)
    if image is None:
        return constant(*factor) if factor.any() else None
    return to_float(rgb(image), srgb=True) * (factor if factor.any() else np.ones(3, np.float32))


def _opacity(name: str, values: dict[str, str], library: _Library) -> tuple[np.ndarray, str]:
    """Opacity, shape (H, W, 1), and the alpha mode."""
    factor = 1.0
    if tr := _numbers(values.get("tr")):
        factor = 1 - tr[0]
    if d := _numbers(values.get("d", "").replace("-halo", "")):
        factor = d[0]
    if factor <= 0:
        # Some exporters mean the opposite of the specification; an invisible mesh is not what anyone sends.
        library.note(f"material '{name}' is fully transparent (d, Tr) and was taken as opaque")
        factor = 1.0
    image = _texture(values, "map_d", library)
    if image is None:
        return constant(min(factor, 1.0)), "BLEND" if factor < 1 else "OPAQUE"
    channel = opacity(image)
    channel = image[..., :1] if channel is None else channel
    alpha = to_float(channel, srgb=False)
    is_cut_out = factor >= 1 and np.isin(alpha, (0, 1)).all()
    return alpha * np.float32(min(factor, 1.0)), "MASK" if is_cut_out else "BLEND"


def _scalar(values: dict[str, str], key: str, map_key: str, default: float, library: _Library) -> np.ndarray:
    image = _texture(values, map_key, library)
    if image is not None:
        return np.clip(to_float(image[..., :1], srgb=False), 0, 1)
    number = _numbers(values.get(key))
    return constant(min(max(number[0], 0.0), 1.0) if number else default)


def _normal_map(name: str, values: dict[str, str], library: _Library) -> np.ndarray | None:
    for key in ("norm", "map_kn"):
        image = _texture(values, key, library)
        if image is not None:
            return unit_normals(to_float(rgb(image), srgb=False) * 2 - 1)
    for key in ("map_bump", "bump"):
        image = _texture(values, key, library)
        if image is not None and is_normal_map(image):  # Blender and others write normal maps there
            library.note(f"{key} of material '{name}' holds a normal map and is used as one")
            return unit_normals(to_float(rgb(image), srgb=False) * 2 - 1)
        if image is not None:
            library.note(f"bump map of material '{name}' ({key}) was left out: it holds heights, not normals")
    return None


def _texture(values: dict[str, str], key: str, library: _Library) -> np.ndarray | None:
    """The decoded image of a texture statement, shape (H, W, C), or None."""
    words = values.get(key, "").split(" ")
    offset, scale, wrap = np.zeros(2), np.ones(2), "repeat"
    while words and (words[0] == "" or words[0].lower() in _OPTIONS):
        if words[0] == "":
            words.pop(0)
            continue
        option = words.pop(0).lower()
        arguments: list[str] = []
        while len(arguments) < _OPTIONS[option] and words and (_is_number(words[0]) or not arguments):
            arguments.append(words.pop(0))
        numbers = [float(a) for a in arguments[:2] if _is_number(a)]
        if option == "-clamp" and arguments[0].lower() == "on":
            wrap = "clamp"
        elif option in ("-o", "-s") and np.isfinite(numbers).all():
            (offset if option == "-o" else scale)[: len(numbers)] = numbers
        neutral = {"-t": 0.0, "-bm": 1.0}.get(option)
        if neutral is not None and any(_is_number(a) and float(a) != neutral for a in arguments):
            library.note(f"option '{option} {' '.join(arguments)}' of {key} was left out")
    uri = " ".join(words).strip().strip('"')
    if not uri:
        return None
    (su, sv), (u, v) = scale, offset
    moved = bool(offset.any() or (scale != 1).any())
    # Of coordinates that grow upwards: v' = sv v + o; ours grow downwards.
    transform = np.array([[su, 0, u], [0, sv, 1 - sv - v]]) if moved else None
    if not library.mappings.take(_TEXTURES.get(key, "normal"), Mapping(0, transform, (wrap, wrap))):
        library.note(f"{key} was left out: its options are not those of the texture that it is joined with")
        return None
    return library.image(uri)


def _listed(names: list[str], most: int = 3) -> str:
    """Some names in one line."""
    shown = ", ".join(f"'{printable(name)}'" for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(value: str | None) -> list[float]:
    """Leading numbers of a statement's value; none where it is missing or of another form."""
    out = []
    for word in (value or "").split():
        if not _is_number(word) or not np.isfinite(float(word)):
            break
        out.append(float(word))
    return out
