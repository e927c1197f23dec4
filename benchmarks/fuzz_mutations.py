"""Mutations of valid files: bytes, lengths, chunks, numbers, members of archives, datasets."""

import io
import re
import zipfile
from collections.abc import Callable

import numpy as np
from fuzz_hdf5 import is_hdf5, redeclared

Random = np.random.Generator

_WORDS = re.compile(rb"[-+.\w/@]+")
_HOSTILE = (
    *(b"nan", b"-inf", b"1e309", b"-1e-320", b"0", b"-1", b"-2147483649", b"4294967295"),
    *(b"99999999999999999999", b"9" * 400, b"", b"\x00", b"../x", b"/x", b"null", b"[]", b"{}"),
    *(b"true", b'"', b"\xff\xfe", b"a" * 300, b"[" * 3000, b"{", b"1/2/3/4"),
)
_PATTERNS = (b"\x00", b"\xff", b"\x7f\xff\xff\xff", b"\x00\x00\xf8\x7f", b"\x00\x00\x00\x80")


def flipped(data: bytes, random: Random) -> bytes:
    """Some bytes at random."""
    changed = bytearray(data)
    for place in random.integers(len(data), size=random.integers(1, 9)):
        changed[place] = random.integers(256)
    return bytes(changed)


def cut(data: bytes, random: Random) -> bytes:
    """The beginning."""
    return data[: random.integers(len(data))]


def doubled(data: bytes, random: Random) -> bytes:
    """A chunk twice."""
    begin, end = np.sort(random.integers(len(data) + 1, size=2))
    return data[:end] + data[begin:end] + data[end:]


def shortened(data: bytes, random: Random) -> bytes:
    """A chunk left out."""
    begin = int(random.integers(len(data)))
    return data[:begin] + data[begin + int(random.integers(1, 65)) :]


def reworded(data: bytes, random: Random) -> bytes:
    """A number or word replaced by one that nobody expects."""
    words = list(_WORDS.finditer(data))
    if not words:
        return flipped(data, random)
    word = words[random.integers(len(words))]
    return data[: word.start()] + _HOSTILE[random.integers(len(_HOSTILE))] + data[word.end() :]


def overwritten(data: bytes, random: Random) -> bytes:
    """Four or eight bytes at once: a huge, a negative, or no number."""
    size = int(random.choice([4, 8]))
    place = int(random.integers(max(1, len(data) - size + 1)))
    pattern = _PATTERNS[random.integers(len(_PATTERNS))]
    return data[:place] + (pattern * size)[:size] + data[place + size :]


_MUTATIONS: tuple[Callable[[bytes, Random], bytes], ...] = (
    *(flipped, cut, doubled, shortened, reworded, reworded, overwritten),
)


def repacked(data: bytes, random: Random) -> bytes:
    """An archive with one member mutated and all checksums right."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(made, "w") as new:
        names = old.namelist()
        chosen = names[random.integers(len(names))]
        for name in names:
            content = old.read(name)
            new.writestr(name, plain(content, random) if name == chosen and content else content)
    return made.getvalue()


def plain(data: bytes, random: Random) -> bytes:
    """One to three mutations."""
    for _ in range(random.integers(1, 4)):
        if data:
            data = _MUTATIONS[random.integers(len(_MUTATIONS))](data, random)
    return data


def mutated(data: bytes, random: Random) -> bytes:
    """A mutated file; every other archive or file of HDF5 by its structure."""
    remade = redeclared if is_hdf5(data) else repacked
    whole = is_hdf5(data) or zipfile.is_zipfile(io.BytesIO(data))
    return remade(data, random) if whole and random.random() < 0.5 else plain(data, random)
