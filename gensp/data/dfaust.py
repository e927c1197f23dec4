"""Registrations of D-FAUST as a raw collection: bodies in motion that share one connectivity.

Source of the layout: Bogo et al., Dynamic FAUST: Registering Human Bodies in Motion, 2017.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from gensp.data.ground_truth import GroundTruth
from gensp.data.keypoints import Record
from gensp.data.raw import require_preparing
from gensp.errors import GenSPError, MissingData, UnreadableMesh, Unsupported
from gensp.files import content_hash
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints

TEMPLATE = "dfaust"
_PATTERN = "registrations_*.hdf5"


@dataclass(frozen=True)
class Motion:
    """One dataset <subject>_<sequence> of a file: so many frames (V, 3, frames)."""

    subject: str
    name: str
    file: Path
    frames: int

    @property
    def key(self) -> str:
        """Name of the dataset in its file."""
        return f"{self.subject}_{self.name}"


class DFaust:
    """Frames of D-FAUST; a shape's id is <subject>_<sequence>_<frame, five digits>.

    Parameters
    ----------
    root
        The folder with registrations_f.hdf5 and registrations_m.hdf5.
    test_subjects, test_sequences
        A frame of one of these subjects, or of one of these sequences, is held out.
    train, test
        So many frames of each side, evenly along all its sequences; None takes all.
    points
        Ground truth at so many vertices of the template, evenly by their number; None takes all.

    Raises
    ------
    MissingData
        The files, a subject or a sequence are missing, or there are fewer frames than asked for.
    Unsupported
        A stage other than prepare asks for it.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        name: str = "dfaust",
        test_subjects: Sequence[str] = (),
        test_sequences: Sequence[str] = (),
        train: int | None = 1180,
        test: int | None = 120,
        points: int | None = 2048,
        up: str = "y",
        on_bad: str = "error",
        max_faces: int | None = None,
        cache: Path | str | None = None,
    ) -> None:
        require_preparing(name, on_bad, root)
        self.name, self.up, self.root = name, up, Path(root)
        self.points = points
        self._held_out = [str(subject) for subject in test_subjects], list(test_sequences)
        self._sequences = {entry.key: entry for entry in _listed(self.root)}
        _require_known(self._held_out, self._sequences)
        frames = {side: self._frames(side) for side in ("train", "test")}
        self._split = {
            id: side
            for side, count in (("train", train), ("test", test))
            for id in _evenly(frames[side], count, side, self.root)
        }

    def ids(self) -> list[str]:
        """The chosen frames: those to learn from, then those held out."""
        return list(self._split)

    def mesh(self, id: str) -> Mesh:
        """The registered frame, in the template's connectivity."""
        key, frame = id.rsplit("_", 1)
        with _opened(self._sequences[key].file) as file:
            vertices = np.array(file[key][:, :, int(frame)], dtype=np.float64)
            faces = np.array(file["faces"], dtype=np.int64)
        return Mesh(vertices, faces, id)

    def digest(self, id: str) -> str:
        """Changes with the frame's vertices, the faces and the number of points."""
        mesh = self.mesh(id)
        return content_hash(mesh.vertices, mesh.faces, self.points)

    @cached_property
    def fingerprint(self) -> str:
        """Changes with the files, the choice of frames and the splits."""
        files = sorted({entry.file for entry in self._sequences.values()})
        return content_hash([_file_digest(path) for path in files], self._split, self.points)

    def unread_keypoints(self) -> dict[str, str]:
        """None: there are no keypoints."""
        return {}

    def columns(self, id: str) -> dict[str, str]:
        """Template, subject, sequence and licence."""
        key, _ = id.rsplit("_", 1)
        entry = self._sequences[key]
        known = {"category": "human", "template": TEMPLATE, "subject": entry.subject}
        source = {"source": "D-FAUST", "licence": "D-FAUST licence"}
        return {**known, "pose": entry.name, **source}

    def ground_truth(self, id: str) -> GroundTruth:
        """The vertices of the template, each on a face that it is a corner of."""
        faces = self.mesh(id).faces
        count = int(faces.max()) + 1
        chosen = np.unique(np.linspace(0, count - 1, min(self.points or count, count)).astype(int))
        return GroundTruth(TEMPLATE, chosen.astype(np.int64), _corners(faces, chosen))

    def keypoint_record(self, id: str) -> Record | None:
        """D-FAUST has no keypoints."""
        return None

    def splits(self, ids: Sequence[str]) -> dict[str, str]:
        """Train and test as the subjects and sequences say."""
        return {id: self._split[id] for id in ids}

    def _frames(self, side: str) -> list[str]:
        subjects, names = self._held_out
        return [
            f"{key}_{frame:05d}"
            for key, entry in self._sequences.items()
            if (entry.subject in subjects or entry.name in names) == (side == "test")
            for frame in range(entry.frames)
        ]


def _corners(faces: Int[np.ndarray, "m 3"], vertices: Int[np.ndarray, " k"]) -> SurfacePoints:
    """The vertices as points of the first face that has them."""
    used, first = np.unique(faces.reshape(-1), return_index=True)
    place = first[np.searchsorted(used, vertices)]
    weights = np.zeros((len(vertices), 3))
    weights[np.arange(len(vertices)), place % 3] = 1.0
    return SurfacePoints(place // 3, weights)


def _evenly(frames: list[str], count: int | None, side: str, root: Path) -> list[str]:
    """`count` of the frames, evenly along their list."""
    if count is None:
        return frames
    if count > len(frames):
        raise MissingData(
            f"{root}: {len(frames)} frames can be {side} frames; shapes.{side}={count} are "
            f"required; ask for fewer, or name other shapes.test_subjects or shapes.test_sequences"
        )
    places = np.linspace(0, len(frames), count, endpoint=False).astype(int)
    return [frames[place] for place in places]


def _listed(root: Path) -> list[Motion]:
    files = sorted(root.glob(_PATTERN)) if root.is_dir() else []
    if not files:
        raise MissingData(
            f"{root}: has no {_PATTERN}; the registrations of D-FAUST are required; set "
            "shapes.root=FOLDER"
        )
    return [entry for path in files for entry in _sequences(path)]


def _sequences(path: Path) -> Iterator[Motion]:
    with _opened(path) as file:
        if "faces" not in file:
            raise UnreadableMesh(
                f"{path}: has no dataset 'faces'; faces (F, 3) and <subject>_<sequence> "
                "(V, 3, frames) are required; download it again"
            )
        for key in sorted(set(file) - {"faces"}):
            shape: tuple[int, ...] = getattr(file[key], "shape", ())
            if "_" not in key or len(shape) != 3 or shape[1] != 3:
                raise UnreadableMesh(
                    f"{path}: '{key}' has the shape {shape}; <subject>_<sequence> of shape "
                    "(V, 3, frames) is required; download it again"
                )
            subject, name = key.split("_", 1)
            yield Motion(subject, name, path, int(shape[2]))


def _require_known(held_out: tuple[list[str], list[str]], sequences: Mapping[str, Motion]) -> None:
    there = (
        ("test_subjects", held_out[0], {entry.subject for entry in sequences.values()}),
        ("test_sequences", held_out[1], {entry.name for entry in sequences.values()}),
    )
    for key, asked, known in there:
        unknown = [word for word in asked if word not in known]
        if unknown:
            raise Unsupported(
                f"shapes.{key}: '{unknown[0]}' is not there; some of {', '.join(sorted(known))} "
                "are required; correct the list"
            )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An HDF5 file; whatever its reader says of it in one line."""
    # Imported late: only this collection needs it.
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except GenSPError:
        raise
    # The reader of a damaged file raises whatever it met; the file is at fault in each case.
    except Exception as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}: {str(error)[:80]}); a whole HDF5 "
            "file of registrations is required; download it again"
        ) from error


def _file_digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
