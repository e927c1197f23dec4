"""Registrations of D-FAUST as a raw collection: bodies in motion that share one connectivity.

Source of the layout: Bogo et al., Dynamic FAUST: Registering Human Bodies in Motion, 2017.
"""

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from gensp.data.ground_truth import GroundTruth
from gensp.data.keypoints import Record
from gensp.data.raw import require_preparing
from gensp.data.registrations import Motion, chosen, listed, opened
from gensp.errors import MissingData, UnreadableMesh, Unsupported
from gensp.files import content_hash
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints

TEMPLATE = "dfaust"


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
        self._sequences = listed(self.root)
        _require_known(self._held_out, self._sequences)
        self._split = {
            id: side
            for side, count in (("train", train), ("test", test))
            for id in self._frames(side, count)
        }

    def ids(self) -> list[str]:
        """The chosen frames: those to learn from, then those held out."""
        return list(self._split)

    def mesh(self, id: str) -> Mesh:
        """The registered frame, in the template's connectivity."""
        key, frame = id.rsplit("_", 1)
        path = self._sequences[key].file
        with opened(path) as file:
            vertices = np.array(file[key][:, :, int(frame)], dtype=np.float64)
            faces = np.array(file["faces"], dtype=np.int64)
        _require_corners(path, key, faces, len(vertices))
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

    def _frames(self, side: str, count: int | None) -> list[str]:
        """`count` of a side's frames, evenly along all its sequences; only these are listed."""
        subjects, names = self._held_out
        own = [
            entry
            for entry in self._sequences.values()
            if (entry.subject in subjects or entry.name in names) == (side == "test")
        ]
        there = sum(entry.frames for entry in own)
        if count is not None and count > there:
            raise MissingData(
                f"{self.root}: {there} frames can be {side} frames; shapes.{side}={count} are "
                f"required; ask for fewer, or name other shapes.test_subjects or "
                "shapes.test_sequences"
            )
        places = np.linspace(0, there, there if count is None else count, endpoint=False)
        return chosen(own, places.astype(np.int64))


def _corners(faces: Int[np.ndarray, "m 3"], vertices: Int[np.ndarray, " k"]) -> SurfacePoints:
    """The vertices as points of the first face that has them."""
    used, first = np.unique(faces.reshape(-1), return_index=True)
    place = first[np.searchsorted(used, vertices)]
    weights = np.zeros((len(vertices), 3))
    weights[np.arange(len(vertices)), place % 3] = 1.0
    return SurfacePoints(place // 3, weights)


def _require_corners(path: Path, key: str, faces: Int[np.ndarray, "m 3"], count: int) -> None:
    if not faces.size or faces.min() < 0 or faces.max() >= count:
        raise UnreadableMesh(
            f"{path}: 'faces' does not fit the {count} vertices of '{key}'; one face at least, of "
            "numbers of vertices, is required; download it again"
        )


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


def _file_digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
