"""Correspondences in files."""

import io
from pathlib import Path

import numpy as np

from gensp.files import save_npz, write_text
from gensp.geometry.matching import Matching


def write_matching(found: Matching, stem: Path, *, rotation: np.ndarray) -> list[Path]:
    """Write <stem>.npz and <stem>.csv; gives both paths.

    The npz has `face` (n,), `barycentric` (n, 3), `positions` (n, 3), `reliability` (n,) and the
    `rotation` (3, 3) of the first shape's sphere; the csv the same, a line a vertex.
    """
    npz, csv = (stem.parent / (stem.name + end) for end in (".npz", ".csv"))
    save_npz(
        npz,
        face=found.at.faces,
        barycentric=found.at.barycentric,
        positions=found.positions,
        reliability=found.reliability,
        rotation=rotation,
    )
    columns = (found.at.barycentric, found.positions, found.reliability[:, None])
    places = np.stack([np.arange(len(found.at)), found.at.faces], axis=1)
    text = io.StringIO("vertex,face,w0,w1,w2,x,y,z,reliability\n")
    text.seek(0, io.SEEK_END)
    form = ",".join(["%d"] * 2 + ["%.17g"] * 7)
    np.savetxt(text, np.concatenate([places, *columns], axis=1), fmt=form)
    write_text(csv, text.getvalue())
    return [npz, csv]
