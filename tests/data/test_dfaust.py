"""D-FAUST: frames, who is held out, the template's vertices as ground truth."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from layouts import BALL, write_dfaust

from gensp.data.dfaust import DFaust
from gensp.errors import MissingData, UnreadableMesh, Unsupported


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dfaust(tmp_path / "dfaust")


def read(root: Path, **words: object) -> DFaust:
    return DFaust(root, on_bad="keep", **{"train": None, "test": None, **words})


def test_frames_are_those_of_the_files(root: Path) -> None:
    shapes = read(root, test_subjects=["50020"])
    assert len(shapes.ids()) == 12
    mesh = shapes.mesh("50004_hips_00002")
    assert np.allclose(mesh.vertices, 1.2 * BALL.vertices, atol=1e-6)
    assert np.array_equal(mesh.faces, BALL.faces)


def test_subjects_and_sequences_are_held_out_whole(root: Path) -> None:
    def held_out(**words: list[str]) -> set[str]:
        shapes = read(root, **words)
        splits = shapes.splits(shapes.ids())
        return {id.rsplit("_", 1)[0] for id, split in splits.items() if split == "test"}

    assert held_out(test_subjects=["50020"]) == {"50020_knees"}
    assert held_out(test_sequences=["hips"]) == {"50004_hips", "50002_hips"}
    assert held_out() == set()


def test_asked_for_numbers_are_spread_along_the_sequences(root: Path) -> None:
    shapes = read(root, test_subjects=["50020"], train=4, test=2)
    splits = shapes.splits(shapes.ids())
    assert sorted(splits.values()) == ["test"] * 2 + ["train"] * 4
    assert [id for id, split in splits.items() if split == "train"] == [
        "50004_hips_00000",
        "50004_hips_00002",
        "50002_hips_00000",
        "50002_hips_00002",
    ]
    with pytest.raises(MissingData, match=r"4 frames can be test frames; shapes\.test=5"):
        read(root, test_subjects=["50020"], test=5)


def test_ground_truth_is_the_template_s_vertices(root: Path) -> None:
    shapes = read(root, points=50)
    truth, mesh = shapes.ground_truth("50002_hips_00003"), shapes.mesh("50002_hips_00003")
    assert len(truth.ids) == 50
    places = truth.at.on(mesh.vertices, mesh.faces)
    assert np.array_equal(places, mesh.vertices[truth.ids])
    assert (truth.ids == shapes.ground_truth("50004_hips_00000").ids).all()


def test_an_unknown_subject_lists_the_known_ones(root: Path) -> None:
    with pytest.raises(Unsupported, match=r"test_subjects: '50025' .* 50002, 50004, 50020"):
        read(root, test_subjects=["50025"])


def test_damaged_files_are_told(root: Path) -> None:
    path = root / "registrations_m.hdf5"
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(UnreadableMesh, match=r"registrations_m\.hdf5: cannot be read"):
        read(root)
    with h5py.File(path, "w") as file:
        file["50002_hips"] = np.zeros((4, 3, 1))
    with pytest.raises(UnreadableMesh, match="has no dataset 'faces'"):
        read(root)


def test_frames_are_refused_where_they_are_learnt_from(root: Path) -> None:
    with pytest.raises(Unsupported, match=r"stage=prepare shapes=dfaust"):
        DFaust(root)
