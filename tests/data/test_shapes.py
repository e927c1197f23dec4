"""Collections: manifests, plain folders, splits, ground truth."""

import json
from pathlib import Path

import numpy as np
import pytest

from gensp.data.ground_truth import (
    GroundTruth,
    common_points,
    load_ground_truth,
    save_ground_truth,
)
from gensp.data.shapes import ShapeCollection
from gensp.errors import MissingData, Unsupported
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.sphere import icosphere

EMBEDDED = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def heads() -> ShapeCollection:
    return ShapeCollection.from_folder(EMBEDDED / "heads")


@pytest.fixture(scope="module")
def quadrupeds() -> ShapeCollection:
    return ShapeCollection.from_folder(EMBEDDED / "quadrupeds")


@pytest.mark.parametrize(
    ("name", "splits", "templates"),
    [("heads", (22, 2, 6), 1), ("quadrupeds", (25, 5, 10), 8)],
)
def test_embedded_collections_are_whole(
    name: str, splits: tuple[int, ...], templates: int, request: pytest.FixtureRequest
) -> None:
    shapes: ShapeCollection = request.getfixturevalue(name)
    assert tuple(len(shapes.ids(split)) for split in ("train", "val", "test")) == splits
    assert len({shapes.shape(id).template for id in shapes.ids()}) == templates
    assert not shapes.skipped
    first, second = shapes.ids()[:2]
    truth, other = shapes.ground_truth(first), shapes.ground_truth(second)
    assert truth is not None
    assert other is not None
    assert truth.at.faces.max() < len(shapes.mesh(first).faces)
    assert np.allclose(truth.at.barycentric.sum(axis=1), 1)
    rows, others = common_points(truth, other)
    assert len(rows) > 1900
    assert (truth.ids[rows] == other.ids[others]).all()


def test_ground_truth_of_one_person_is_close_in_space(heads: ShapeCollection) -> None:
    places = []
    for id in ("id000_neutral", "id000_expr"):
        mesh, truth = heads.mesh(id), heads.ground_truth(id)
        assert truth is not None
        places.append((truth, truth.at.on(mesh.vertices, mesh.faces)))
    rows, others = common_points(places[0][0], places[1][0])
    apart = np.linalg.norm(places[0][1][rows] - places[1][1][others], axis=1)
    size = np.ptp(places[0][1], axis=0).max()
    assert np.median(apart) < 0.01 * size


def test_keypoints_lie_where_the_record_says(quadrupeds: ShapeCollection) -> None:
    records = json.loads((EMBEDDED / "quadrupeds" / "keypoints.json").read_text())
    record = next(entry for entry in records if entry["model_id"] == "fox_rest")
    mesh, keypoints = quadrupeds.mesh("fox_rest"), quadrupeds.keypoints("fox_rest")
    assert keypoints is not None
    assert keypoints.ids.tolist() == [point["semantic_id"] for point in record["keypoints"]]
    expected = np.array([point["xyz"] for point in record["keypoints"]])
    assert np.abs(keypoints.at.on(mesh.vertices, mesh.faces) - expected).max() < 1e-4


def test_points_in_common_are_dense_within_a_kind_and_keypoints_across(
    quadrupeds: ShapeCollection, heads: ShapeCollection
) -> None:
    horse, other, dense = quadrupeds.points_in_common("horse_rest", "horse_gallop_jump")
    assert dense
    assert len(horse) == len(other) > 1000
    across = quadrupeds.points_in_common("horse_rest", "cow_gallop")
    keypoints = quadrupeds.keypoints("horse_rest")
    assert not across[2]
    np.testing.assert_array_equal(np.sort(across[0].faces), np.sort(keypoints.at.faces))
    assert heads.points_in_common("id000_neutral", "id003_expr")[2]


def test_ground_truth_round_trip_leaves_out_unmatched_rows(
    tmp_path: Path, bumpy: Mesh, rng: np.random.Generator
) -> None:
    truth = GroundTruth("t", np.arange(40), sample_surface(bumpy.face_areas, 40, rng))
    save_ground_truth(tmp_path / "a.npz", truth)
    read = load_ground_truth(tmp_path / "a.npz", "t")
    assert (read.ids == truth.ids).all()
    assert np.allclose(
        read.at.on(bumpy.vertices, bumpy.faces), truth.at.on(bumpy.vertices, bumpy.faces)
    )
    arrays = dict(np.load(tmp_path / "a.npz"))
    arrays["face"][:5] = -1
    np.savez(tmp_path / "b.npz", **arrays)
    assert load_ground_truth(tmp_path / "b.npz", "t").ids.tolist() == list(range(5, 40))


def test_points_of_other_templates_are_not_common(bumpy: Mesh, rng: np.random.Generator) -> None:
    at = sample_surface(bumpy.face_areas, 3, rng)
    one, other = GroundTruth("a", np.arange(3), at), GroundTruth("b", np.arange(3), at)
    assert len(common_points(one, other)[0]) == 0
    assert len(common_points(one, one)[0]) == 3


@pytest.fixture
def folder(tmp_path: Path, bumpy: Mesh, ellipsoid: Mesh, dumbbell: Mesh) -> Path:
    for mesh, suffix in ((bumpy, "ply"), (ellipsoid, "obj"), (dumbbell, "off")):
        save_mesh(mesh, tmp_path / f"{mesh.name}.{suffix}")
    save_mesh(bumpy, tmp_path / "nested" / "soup.stl")
    (tmp_path / "notes.txt").write_text("not a mesh")
    return tmp_path


def test_plain_folder_reads_every_format_for_training(folder: Path, bumpy: Mesh) -> None:
    shapes = ShapeCollection.from_folder(folder)
    assert shapes.ids() == ["bumpy", "dumbbell", "ellipsoid", "nested_soup"]
    assert shapes.ids("train") == shapes.ids()
    assert shapes.ground_truth("bumpy") is None
    assert shapes.keypoints("bumpy") is None
    for id in shapes.ids():
        assert shapes.mesh(id).euler == 2
        assert shapes.mesh(id).name == id
    assert np.allclose(shapes.mesh("bumpy").vertices, bumpy.vertices, atol=1e-6)


def test_plain_folder_with_ground_truth_files(
    folder: Path, bumpy: Mesh, rng: np.random.Generator
) -> None:
    truth = GroundTruth("t", np.arange(9), sample_surface(bumpy.face_areas, 9, rng))
    save_ground_truth(folder / "corr" / "bumpy.npz", truth)
    shapes = ShapeCollection.from_folder(folder, name="mine")
    found = shapes.ground_truth("bumpy")
    assert found is not None
    assert found.template == "mine"
    assert shapes.ground_truth("ellipsoid") is None


def test_held_out_share_is_drawn_by_its_seed(folder: Path) -> None:
    one = ShapeCollection.from_folder(folder, test_fraction=0.5, split_seed=1)
    again = ShapeCollection.from_folder(folder, test_fraction=0.5, split_seed=1)
    assert len(one.ids("test")) == 2
    assert one.ids("test") == again.ids("test")
    assert sorted(one.ids("test", "train")) == sorted(one.ids())
    with pytest.raises(Unsupported, match=r"shapes\.test_fraction=1\.0.*below 1"):
        ShapeCollection.from_folder(folder, test_fraction=1.0)


def test_manifest_gives_splits_templates_and_order(folder: Path) -> None:
    (folder / "manifest.csv").write_text(
        "file,category,split,correspondence\nellipsoid.obj,egg,test,\nbumpy.ply,stone,train,\n"
    )
    shapes = ShapeCollection.from_folder(folder)
    assert shapes.ids() == ["ellipsoid", "bumpy"]
    assert shapes.ids("test") == ["ellipsoid"]
    assert shapes.shape("bumpy").template is None


def test_wrong_manifests_say_what_is_needed(folder: Path) -> None:
    manifest = folder / "manifest.csv"
    manifest.write_text("file,split\nbumpy.ply,training\n")
    with pytest.raises(MissingData, match=r"manifest\.csv: bumpy\.ply has the split 'training'"):
        ShapeCollection.from_folder(folder)
    manifest.write_text("name\nbumpy\n")
    with pytest.raises(MissingData, match="no rows with a column 'file'"):
        ShapeCollection.from_folder(folder)


def test_missing_folders_name_the_key(tmp_path: Path) -> None:
    with pytest.raises(MissingData, match=r"nowhere: is not a folder.*shapes\.root"):
        ShapeCollection.from_folder(tmp_path / "nowhere")
    with pytest.raises(MissingData, match=r"holds no mesh.*shapes\.root"):
        ShapeCollection.from_folder(tmp_path)


def test_ids_must_be_unique_and_free(folder: Path, bumpy: Mesh) -> None:
    save_mesh(bumpy, folder / "bumpy.obj")
    with pytest.raises(Unsupported, match="same id 'bumpy'"):
        ShapeCollection.from_folder(folder)
    (folder / "bumpy.obj").rename(folder / "sphere.obj")
    with pytest.raises(Unsupported, match="'sphere' is taken"):
        ShapeCollection.from_folder(folder)


def test_unknown_shape_is_named(folder: Path) -> None:
    with pytest.raises(MissingData, match="shape 'cow' is not in collection"):
        ShapeCollection.from_folder(folder).mesh("cow")


def test_equal_collections_are_equal(folder: Path) -> None:
    one, other = ShapeCollection.from_folder(folder), ShapeCollection.from_folder(folder)
    assert one == other
    assert hash(one) == hash(other)
    assert one != ShapeCollection.from_folder(folder, test_fraction=0.5)


def test_fingerprint_follows_the_content_of_the_files(tmp_path: Path) -> None:
    ball = icosphere(1)
    save_mesh(ball, tmp_path / "one.ply")
    first = ShapeCollection.from_folder(tmp_path, name="few").fingerprint
    assert ShapeCollection.from_folder(tmp_path, name="few").fingerprint == first
    save_mesh(ball.with_vertices(1.01 * ball.vertices), tmp_path / "one.ply")
    assert ShapeCollection.from_folder(tmp_path, name="few").fingerprint != first


def test_file_that_cannot_be_opened_is_one_line(tmp_path: Path, monkeypatch) -> None:
    save_mesh(icosphere(1), tmp_path / "one.ply")
    save_mesh(icosphere(1), tmp_path / "two.ply")
    read = Path.read_bytes

    def refused(path: Path) -> bytes:
        if path.name == "one.ply":
            raise PermissionError(13, "Permission denied")
        return read(path)

    # Permissions do not bind a superuser, so the refusal is simulated.
    monkeypatch.setattr(Path, "read_bytes", refused)
    collection = ShapeCollection.from_folder(tmp_path, on_bad="skip")
    assert collection.ids() == ["two"]
    ((name, reason),) = collection.skipped
    assert name == "one"
    assert "one.ply: cannot be opened (Permission denied)" in reason
