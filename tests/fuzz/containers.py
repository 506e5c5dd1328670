"""
Damage to files that are made of parts: a part is mutated and the whole put together again, so that it gets further in.
"""

from __future__ import annotations

import copy
import io
import struct
import warnings
import zipfile
import zlib
from xml.etree import ElementTree

import numpy as np
from mutations import NUMBERS, edge, flip, mutate, noise


def glb(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """
    A GLB whose JSON or buffer is mutated, its lengths set right again.
    """
    (text, binary), (other_text, other_binary) = _chunks(data), _chunks(other)
    if rng.random() < 0.7:
        text = mutate(text, other_text, rng, text=True)
    else:
        binary = mutate(binary, other_binary, rng, text=False)
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    n = struct.unpack_from("<I", data, 12)[0]
    return data[20 : 20 + n], data[28 + n :]


def png(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """
    A PNG with mutated chunks and true checksums; ``other`` lends it chunks.
    """
    chunks, foreign = _png_chunks(data), _png_chunks(other)
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(len(chunks)))
        kind, body = chunks[k]
        match rng.integers(6):
            case 0 if len(chunks) > 1:
                del chunks[k]
            case 1:
                chunks.insert(int(rng.integers(len(chunks))), foreign[rng.integers(len(foreign))])
            case 2 if kind == b"IDAT" and body:
                try:
                    body = zlib.compress(mutate(zlib.decompress(body), body, rng, text=False))
                except zlib.error:
                    body = mutate(body, body, rng, text=False)
                chunks[k] = kind, body
            case 3:
                size = [int(2 ** rng.uniform(0, 31)) for _ in range(2)]
                chunks[0] = b"IHDR", struct.pack(">2I", *size) + chunks[0][1][8:]
            case 4:
                chunks[0] = b"IHDR", edge(chunks[0][1] or b"\0", b"", rng)
            case _:
                chunks[k] = kind, mutate(body or b"\0", other, rng, text=False)
    out = data[:8]
    for kind, body in chunks:
        out += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    return out


def _png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, at = [], 8
    while at + 8 <= len(data):
        n = struct.unpack_from(">I", data, at)[0]
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + n]))
        at += 12 + n
    return chunks


def usdc(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """
    A crate with bytes changed in place, in its values or in one of its sections, or with another table of these.
    """
    table = struct.unpack_from("<q", data, 16)[0]
    n = struct.unpack_from("<Q", data, table)[0]
    if n > len(data) // 32:
        raise ValueError("more sections than bytes")
    places = [table + 8 + 32 * k for k in range(n)]
    spans = [struct.unpack_from("<2q", data, at + 16) for at in places]
    first = min(begin for begin, _ in spans)
    regions = [(88, first - 88)] * 3 + [(begin, size) for begin, size in spans]
    for _ in range(rng.integers(1, 5)):
        if rng.random() < 0.15:
            begin, size = places[rng.integers(n)] + 16, 16
        else:
            begin, size = regions[rng.integers(len(regions))]
        part = data[begin : begin + size]
        if part:
            change = (edge, edge, flip, noise)[rng.integers(4)]
            data = data[:begin] + change(part, b"", rng)[:size] + data[begin + size :]
    return data


def usdz(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """
    A package whose members are mutated, renamed, moved, left out or doubled.
    """
    members, foreign = _members(data), _members(other)
    for _ in range(rng.integers(1, 3)):
        k = int(rng.integers(len(members)))
        name, body = members[k]
        match rng.integers(8):
            case 0 if len(members) > 1:
                del members[k]
            case 1:
                members.insert(int(rng.integers(len(members) + 1)), foreign[rng.integers(len(foreign))])
            case 2:
                names = ("../a.usda", "/etc/hostname", "", "a.usdz", "b/c.usda", "image.png", "a.usd", name[::-1])
                members[k] = names[rng.integers(len(names))], body
            case _:
                members[k] = name, _mutated_member(name, body, rng)
    return zipped(members)


def _mutated_member(name: str, body: bytes, rng: np.random.Generator) -> bytes:
    if name.endswith(".usdc") and body[:8] == b"PXR-USDC" and rng.random() < 0.7:
        try:
            return usdc(body, body, rng)
        except (struct.error, ValueError):  # mutated once already
            pass
    return mutate(body or b"\0", body or b"\0", rng, text=name.endswith(".usda"))


def _members(data: bytes) -> list[tuple[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        return [(info.filename, file.read(info)) for info in file.infolist()]


def zipped(members: list[tuple[str, bytes]]) -> bytes:
    """
    A USDZ package: files as they are, each at a multiple of 64 bytes.
    """
    out = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(out, "w") as file:  # names may come twice
        for name, body in members:
            info = zipfile.ZipInfo(name)
            padding = -(out.tell() + 34 + len(name.encode())) % 64
            info.extra = struct.pack("<HH", 0x1986, padding) + bytes(padding)
            file.writestr(info, body)
    return out.getvalue()


def xml(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """
    Elements dropped, doubled, moved into others or taken from ``other``; attributes changed and exchanged.
    """
    root, foreign = ElementTree.fromstring(data), list(ElementTree.fromstring(other).iter())
    for _ in range(rng.integers(1, 5)):
        parents = [(parent, child) for parent in root.iter() for child in parent]
        every = list(root.iter())
        element = every[rng.integers(len(every))]
        match rng.integers(8):
            case 0 if parents:
                parent, child = parents[rng.integers(len(parents))]
                parent.remove(child)
            case 1 if parents:
                _, child = parents[rng.integers(len(parents))]
                if element not in child.iter():
                    element.append(child)
            case 2:
                element.append(copy.deepcopy(foreign[rng.integers(len(foreign))]))  # or it might hold itself one day
            case 3:
                element.tag = every[rng.integers(len(every))].tag
            case 4:
                source = every[rng.integers(len(every))]
                element.attrib.update(source.attrib)
            case 5 if element.attrib:
                del element.attrib[_one(element.attrib, rng)]
            case _ if element.attrib:
                words = [value for e in (*every, *foreign) for value in e.attrib.values()]
                new = words[rng.integers(len(words))] if rng.random() < 0.5 else _number(rng)
                element.attrib[_one(element.attrib, rng)] = new
    out = ElementTree.tostring(root)
    return mutate(out, data, rng, text=True) if rng.random() < 0.2 else out


def _one(attributes: dict[str, str], rng: np.random.Generator) -> str:
    return list(attributes)[rng.integers(len(attributes))]


def _number(rng: np.random.Generator) -> str:
    """One or several numbers, as vectors have them."""
    return " ".join(NUMBERS[rng.integers(len(NUMBERS))].decode() for _ in range(int(rng.choice([1, 1, 3, 16]))))
