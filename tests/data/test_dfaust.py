"""D-FAUST: frames, who is held out, the template's vertices as ground truth."""

import tracemalloc
from collections.abc import Callable
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


def test_a_sequence_of_both_files_is_refused(root: Path) -> None:
    with h5py.File(root / "registrations_m.hdf5", "r+") as file:
        file["50004_hips"] = np.zeros((len(BALL.vertices), 3, 1), np.float32)
    line = r"_m\.hdf5: has '50004_hips', which .*_f\.hdf5 has too; .*remove one of the files"
    with pytest.raises(UnreadableMesh, match=line):
        read(root)


def test_no_more_frames_are_listed_than_are_asked_for(tmp_path: Path) -> None:
    """Of 300,000 frames four: the same as evenly from a list of all, in memory for the four."""
    root = tmp_path / "long"
    root.mkdir()
    with h5py.File(root / "registrations_f.hdf5", "w") as file:
        file["faces"] = BALL.faces[:1] * 0
        for name, frames in (("1_a", 100_000), ("2_b", 200_000)):
            file[name] = np.zeros((1, 3, frames), np.int8)
    everything = read(root).ids()
    expected = [everything[place] for place in (0, 75_000, 150_000, 225_000)]
    tracemalloc.start()
    assert read(root, train=4).ids() == expected
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def declared(file: h5py.File) -> None:
    """A billion frames in two kilobytes: chunks that were never written."""
    file.create_dataset("50002_hips", (4, 3, 10**9), np.float32, chunks=(4, 3, 1000))


def without_vertices(file: h5py.File) -> None:
    file.create_dataset("50002_hips", (0, 3, 10**9), np.float32)


def compressed(file: h5py.File) -> None:
    shape = (1000, 3, 1000)
    file.create_dataset("50002_hips", data=np.zeros(shape, np.int8), compression="gzip")


def chunked(file: h5py.File) -> None:
    """A small dataset whose one chunk would take a GiB."""
    words = {"chunks": (2**15, 3, 2**11), "maxshape": (None, 3, None)}
    file.create_dataset("50002_hips", (4, 3, 1), np.float32, **words)
    file["50002_hips"].id.write_direct_chunk((0, 0, 0), b"\0" * 8)


def external(file: h5py.File) -> None:
    words = {"external": [("other.raw", 0, 48)]}
    file.create_dataset("50002_hips", (4, 3, 1), np.float32, **words)


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((4, 3, 10**6), np.float32)
    layout[:, :, :1] = h5py.VirtualSource("other.hdf5", "50004_hips", (4, 3, 1))
    file.create_virtual_dataset("50002_hips", layout)


def linked(file: h5py.File) -> None:
    file["50002_hips"] = h5py.ExternalLink("registrations_f.hdf5", "50004_hips")


def texts(file: h5py.File) -> None:
    file.create_dataset("50002_hips", (4, 3, 1), h5py.string_dtype())


HOSTILE = {
    declared: r"'50002_hips' declares 48000000000 bytes, of which 0 are there \(more than 100",
    without_vertices: r"declare 1000000008 frames; at most 1000000 of all sequences",
    compressed: r"'50002_hips' declares 3000000 bytes, of which \d+ are there \(more than 100",
    chunked: r"'50002_hips' declares 805306368 bytes, of which 8 are there",
    external: r"'50002_hips' is a link, or lies in another file",
    virtual: r"'50002_hips' is a link, or lies in another file",
    linked: r"'50002_hips' is a link, or lies in another file",
    texts: r"'50002_hips' has the shape \(4, 3, 1\) of object",
}


@pytest.mark.parametrize("make", HOSTILE)
def test_more_than_a_file_can_hold_is_refused(
    root: Path, make: Callable[[h5py.File], None]
) -> None:
    with h5py.File(root / "registrations_m.hdf5", "w") as file:
        file["faces"] = BALL.faces
        make(file)
    with pytest.raises(UnreadableMesh, match=f"{HOSTILE[make]}.* required.*; download") as told:
        read(root, train=4)
    assert "\n" not in str(told.value)


def test_faces_beyond_the_vertices_are_refused(root: Path) -> None:
    with h5py.File(root / "registrations_m.hdf5", "r+") as file:
        file["faces"][0, 0] = 2**32 - 1
    with pytest.raises(UnreadableMesh, match="does not fit the 162 vertices of '50002_hips'"):
        read(root).mesh("50002_hips_00000")
