"""Mutations of HDF5 files by their structure: what a file declares, and what it does not hold.

Bytes at random hardly ever reach these: most of them spoil a checksum or a signature before.
"""

import io
from collections.abc import Callable

import h5py
import numpy as np

Random = np.random.Generator

_SIZES = (0, 1, 2, 3, 4, 255, 4096, 10**6, 2**31 - 1, 2**31, 2**32, 10**9, 2**40, 2**62)
_TYPES = (np.int8, np.uint8, np.float16, np.float32, np.float64, np.uint64, np.complex128, "S5")
_FILTERS = (None, "gzip", "lzf", 9)
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def is_hdf5(data: bytes) -> bool:
    """Whether it begins as files of HDF5 do."""
    return data.startswith(_SIGNATURE)


def redeclared(data: bytes, random: Random) -> bytes:
    """A file that HDF5 itself finds whole, with one to three hostile datasets, types or links."""
    made = io.BytesIO(data)
    with h5py.File(made, "r+") as file:
        for _ in range(random.integers(1, 4)):
            names = sorted(file)
            name = names[random.integers(len(names))] if names else "1_a"
            change = _CHANGES[random.integers(len(_CHANGES))]
            try:
                change(file, name, random)
            # HDF5 refuses some sizes, types and filters: those are no files.
            except (ValueError, TypeError, OSError, RuntimeError, OverflowError, KeyError):
                continue
    return made.getvalue()


def _shape(random: Random) -> tuple[int, int, int]:
    """Two hostile sizes around the three that is right, most times."""
    sizes = [_SIZES[place] for place in random.integers(len(_SIZES), size=3)]
    return (sizes[0], 3 if random.random() < 0.8 else sizes[1], sizes[2])


def _anew(file: h5py.File, name: str, random: Random, **words: object) -> None:
    """A dataset in place of another, which nobody fills."""
    shape = _shape(random)[: 2 if name == "faces" else 3]
    if name in file:
        del file[name]
    file.create_dataset(name, shape, _TYPES[random.integers(len(_TYPES))], **words)


def _content(file: h5py.File, name: str) -> np.ndarray:
    """What a dataset holds, unless an earlier change made it hostile."""
    if not 0 < getattr(file[name], "nbytes", 0) < 10**6 or file[name].is_virtual:
        raise ValueError("nothing to change")
    return np.asarray(file[name][()])


def _unwritten(file: h5py.File, name: str, random: Random) -> None:
    _anew(file, name, random)


def _chunked(file: h5py.File, name: str, random: Random) -> None:
    sizes = [int(2 ** random.integers(0, 14)) for _ in range(2 if name == "faces" else 3)]
    sizes[1] = 3
    limits = (None,) * len(sizes)
    packed = _FILTERS[random.integers(len(_FILTERS))]
    _anew(file, name, random, chunks=tuple(sizes), maxshape=limits, compression=packed)
    if random.random() < 0.5 and packed is None:
        file[name].id.write_direct_chunk((0,) * len(sizes), random.bytes(random.integers(1, 999)))


def _packed(file: h5py.File, name: str, random: Random) -> None:
    """Real content that shrinks a thousand times."""
    frames = int(10 ** random.integers(0, 5))
    content = np.zeros((4, 3, frames)[: 2 if name == "faces" else 3], np.float32)
    del file[name]
    file.create_dataset(name, data=content, compression=9)


def _grown(file: h5py.File, name: str, random: Random) -> None:
    """Content of which the declaration is a large multiple."""
    content = _content(file, name)
    del file[name]
    limits = (None,) * content.ndim
    grown = file.create_dataset(name, data=content, maxshape=limits, chunks=content.shape)
    size = list(content.shape)
    size[random.choice([0, -1])] = _SIZES[random.integers(len(_SIZES))]
    grown.resize(size)


def _elsewhere(file: h5py.File, name: str, random: Random) -> None:
    """Content of other files, by three ways."""
    way = random.integers(3)
    del file[name]
    if way == 0:
        file[name] = h5py.ExternalLink("registrations_f.hdf5", str(name))
    elif way == 1:
        file.create_dataset(name, (4, 3, 9), np.float32, external=[("/dev/zero", 0, 432)])
    else:
        layout = h5py.VirtualLayout((4, 3, 10**6), np.float32)
        layout[:, :, :1] = h5py.VirtualSource("other.hdf5", "x", (4, 3, 1))
        file.create_virtual_dataset(name, layout)


def _linked(file: h5py.File, name: str, random: Random) -> None:
    """A name more for what is there, for nothing, for itself or for the root."""
    target = ("/faces", "/nothing", f"/{name}", "/")[random.integers(4)]
    link = ("9_z", name, "faces", "50004_hips")[random.integers(4)]
    if link in file:
        del file[link]
    file[link] = h5py.SoftLink(target)


def _other_kind(file: h5py.File, name: str, random: Random) -> None:
    """A group, texts, or no values at all."""
    way = random.integers(3)
    del file[name]
    if way == 0:
        file.create_group(name)
    elif way == 1:
        file.create_dataset(name, (4, 3, 2), h5py.string_dtype())
    else:
        file[name] = h5py.Empty(np.float32)


def _many(file: h5py.File, name: str, random: Random) -> None:
    """Many sequences of many frames."""
    frames = int(_SIZES[random.integers(len(_SIZES))])
    for number in range(random.integers(1, 60)):
        file.create_dataset(f"{number}_{name}", (1, 3, frames), np.int8)


def _numbers(file: h5py.File, name: str, random: Random) -> None:
    """Numbers that are no places, or no vertices."""
    content = _content(file, name)
    at = tuple(random.integers(size) for size in content.shape)
    value = random.choice([0, 1, 2**31, 2**32 - 1, np.nan, np.inf, -1])
    with np.errstate(all="ignore"):
        content[at] = np.asarray(value).astype(content.dtype)
    file[name][...] = content


_CHANGES: tuple[Callable[[h5py.File, str, Random], None], ...] = (
    *(_unwritten, _chunked, _packed, _grown, _elsewhere, _linked, _other_kind, _many, _numbers),
)
