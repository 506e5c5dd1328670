"""
Damage to files: bytes flipped and spliced, numbers and lines replaced, checksums mended so that it gets further in.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

import numpy as np

#: What stands in for a number of a text.
NUMBERS = (
    b"0", b"-1", b"1", b"2", b"3", b"7", b"255", b"256", b"65536", b"2147483647", b"-2147483648", b"4294967295",
    b"9223372036854775807", b"99999999999999999999", b"1e30", b"-1e30", b"1e308", b"1e999", b"1e-320", b"nan", b"inf",
    b"-inf", b"0.5", b"1000000", b"100000000", b"3000000000", b"", b"x", b"null", b"[]", b"{}", b"true", b'"a"', b"-0",
)  # fmt: skip

#: Numbers of 1, 2, 4 and 8 bytes at the edges of their types.
_EDGES = [
    struct.pack(order + code, value)
    for order in "<>"
    for code, values in (("b", (0, -1, 127, -128)), ("h", (0, -1, 32767, -32768)), ("q", (0, -1, 2**62)),
                         ("i", (0, -1, 1, 2**31 - 1, -(2**31), 2**28, 10**6)),
                         ("f", (float("nan"), float("inf"), 3e38, -1e30, 1e-45)))
    for value in values
]  # fmt: skip

_WORD = re.compile(rb"[A-Za-z_][\w:]*")
_NUMBER = re.compile(rb"[-+]?\.?\d[\d.eE+-]*")

Mutation = Callable[[bytes, bytes, np.random.Generator], bytes]


def mutate(data: bytes, other: bytes, rng: np.random.Generator, text: bool) -> bytes:
    """
    One to four random mutations of ``data``.

    Parameters
    ----------
    data, other : bytes
        Two files of a kind; parts of the second may end up in the first.
    rng : Generator
    text : bool
        Mostly lines, words and numbers instead of bytes.
    """
    choice = _TEXT * 3 + _BINARY if text else _BINARY
    for _ in range(rng.integers(1, 5)):
        if data:
            data = choice[rng.integers(len(choice))](data, other, rng)
    return data


def _at(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data)))


def _span(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    """A range that is short as often as long."""
    begin = _at(data, rng)
    return begin, min(len(data), begin + int(2 ** rng.uniform(0, np.log2(len(data) + 1))))


def flip(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Some bits."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 9)):
        out[_at(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(out)


def truncate(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """The beginning of the file."""
    return data[: _at(data, rng)]


def splice(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """The beginning of one file, the end of another."""
    return data[: _at(data, rng)] + (other[_at(other, rng) :] if other else b"")


def cut(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A piece taken out."""
    begin, end = _span(data, rng)
    return data[:begin] + data[end:]


def repeat(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A piece several times."""
    begin, end = _span(data, rng)
    return data[:end] + data[begin:end] * min(int(rng.integers(1, 20)), 1 + 100_000 // (end - begin)) + data[end:]


def edge(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A binary number at the edge of its type, in place."""
    value, at = _EDGES[rng.integers(len(_EDGES))], _at(data, rng)
    return data[:at] + value + data[at + len(value) :]


def noise(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A short run of any bytes, in place."""
    at, n = _at(data, rng), int(rng.integers(1, 9))
    return data[:at] + rng.integers(0, 256, n, dtype=np.uint8).tobytes() + data[at + n :]


def _replaced(data: bytes, pattern: re.Pattern, new: bytes | None, rng: np.random.Generator) -> bytes:
    """One match replaced, by another match of the same file where ``new`` is None."""
    found = list(pattern.finditer(data))
    if not found:
        return data
    match = found[rng.integers(len(found))]
    new = found[rng.integers(len(found))][0] if new is None else new
    return data[: match.start()] + new + data[match.end() :]


def number(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A number of the text becomes huge, negative, NaN, or none."""
    return _replaced(data, _NUMBER, NUMBERS[rng.integers(len(NUMBERS))], rng)


def word(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A word becomes another one of the text."""
    return _replaced(data, _WORD, None, rng)


def swapped_number(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A number becomes another one of the text."""
    return _replaced(data, _NUMBER, None, rng)


def line(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A line is dropped, doubled, moved, or comes from the other file."""
    lines = data.splitlines(keepends=True)
    k, to = int(rng.integers(len(lines))), int(rng.integers(len(lines) + 1))
    match rng.integers(4):
        case 0:
            del lines[k]
        case 1:
            lines[to:to] = [lines[k]] * int(2 ** rng.uniform(0, 8))
        case 2:
            lines.insert(to, lines[k])
        case _:
            foreign = other.splitlines(keepends=True)
            lines[to:to] = foreign[:1] if not foreign else [foreign[rng.integers(len(foreign))]]
    return b"".join(lines)


def bracket(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """Something opens often and never closes."""
    at = _at(data, rng)
    opening = (b"[", b"{", b"(", b'{"a":', b"- ", b'"', b"'", b"\\", b"@", b"<", b"/")[rng.integers(11)]
    return data[:at] + opening * int(2 ** rng.uniform(0, 14)) + data[at:]


_BINARY: list[Mutation] = [flip, truncate, splice, cut, repeat, edge, noise]
_TEXT: list[Mutation] = [number, number, swapped_number, word, line, line, bracket]
