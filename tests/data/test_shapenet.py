"""ShapeNetCore.v2 and KeypointNet: what is listed, which split, which annotation."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from layouts import ANNOTATED, BOTTLE, KNIFE, SKEWED, write_keypointnet, write_shapenet

from gensp.data.keypoints import keypoint_distance, symmetry_groups
from gensp.data.shapenet import ShapeNet
from gensp.errors import BadMesh, MissingData, Unsupported

FIRST, SECOND = f"{BOTTLE}_{ANNOTATED}", f"{BOTTLE}_{SKEWED}"
LOST, RING = f"{BOTTLE}_{'c' * 32}", f"{KNIFE}_{'d' * 32}"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    return write_shapenet(tmp_path / "ShapeNetCore.v2")


@pytest.fixture
def annotations(tmp_path: Path) -> Path:
    return write_keypointnet(tmp_path / "KeypointNet")


def read(tree: Path, **words: object) -> ShapeNet:
    return ShapeNet(tree, on_bad="keep", **words)


def test_every_model_of_the_tree_is_listed(tree: Path) -> None:
    shapes = read(tree)
    assert shapes.ids() == [FIRST, SECOND, LOST, RING]
    assert shapes.columns(RING)["category"] == "knife"
    assert len(shapes.mesh(FIRST).faces) == 2 * 320
    assert shapes.mesh(FIRST).name == FIRST


def test_a_folder_without_a_model_is_told(tree: Path) -> None:
    with pytest.raises(BadMesh, match=r"model_normalized\.obj: does not exist"):
        read(tree).mesh(LOST)


@pytest.mark.parametrize("synsets", [["bottle"], [BOTTLE]])
def test_synsets_by_name_or_number(tree: Path, synsets: list[str]) -> None:
    assert read(tree, synsets=synsets).ids() == [FIRST, SECOND, LOST]


def test_an_unknown_synset_lists_the_known_ones(tree: Path) -> None:
    with pytest.raises(MissingData, match=r"no synset sofa; .* bottle, knife, .*shapes\.synsets"):
        read(tree, synsets=["sofa"])


def test_annotations_belong_to_their_models(tree: Path, annotations: Path) -> None:
    shapes = read(tree, keypoints=annotations, annotated=True)
    assert shapes.ids() == [FIRST, SECOND]
    record = shapes.keypoint_record(FIRST)
    assert record is not None
    assert [point["semantic_id"] for point in record["keypoints"]] == [4, 5, 6]
    assert symmetry_groups(record) == [(5, 6)]
    assert read(tree).keypoint_record(FIRST) is None


def test_a_misaligned_annotation_is_far_from_its_model(tree: Path, annotations: Path) -> None:
    shapes = read(tree, keypoints=annotations)
    assert keypoint_distance(shapes.keypoint_record(FIRST), shapes.mesh(FIRST)) < 1e-5
    assert keypoint_distance(shapes.keypoint_record(SECOND), shapes.mesh(SECOND)) > 0.05


def test_splits_come_from_either_file_or_are_drawn(tree: Path, annotations: Path) -> None:
    listed = read(tree, split_file=tree / "all.csv")
    assert listed.ids() == [FIRST, SECOND, RING]
    assert listed.splits([FIRST, RING]) == {FIRST: "train", RING: "test"}
    named = read(tree, split_file=annotations / "splits")
    assert named.splits(named.ids()) == {FIRST: "test", SECOND: "train"}
    # The same model of another synset is another entry.
    rows = (tree / "all.csv").read_text().replace(f"{KNIFE},{KNIFE}", f"{BOTTLE},{BOTTLE}")
    (tree / "all.csv").write_text(rows)
    assert read(tree, split_file=tree / "all.csv").ids() == [FIRST, SECOND]
    ids = [f"{BOTTLE}_{k}" for k in range(1000)]
    drawn = read(tree).splits(ids)
    assert sum(split == "test" for split in drawn.values()) == 100
    assert drawn == read(tree).splits(ids)
    assert drawn != read(tree, split_seed=1).splits(ids)


def test_a_model_of_two_synsets_is_on_one_side(tree: Path) -> None:
    twice = [f"{synset}_{k}" for synset in (BOTTLE, KNIFE) for k in range(40)]
    sides = read(tree, test_fraction=0.5).splits(twice)
    held = {id.split("_")[1] for id, side in sides.items() if side == "test"}
    assert len(held) == 20
    assert all((id.split("_")[1] in held) == (side == "test") for id, side in sides.items())
    cut = read(tree, train=25, test=10).splits(twice)
    assert sorted(cut.values()) == ["test"] * 10 + ["train"] * 25
    assert len({id.split("_")[1] for id in cut}) == 35


def test_the_usable_shapes_are_cut_to_what_is_asked_for(tree: Path) -> None:
    ids = [f"{BOTTLE}_{k}" for k in range(1100)]
    cut = read(tree, train=900, test=100).splits(ids)
    assert sorted(cut.values()) == ["test"] * 100 + ["train"] * 900
    assert cut == read(tree, train=900, test=100).splits(ids)
    assert cut != read(tree, train=900, test=100, split_seed=1).splits(ids)
    listed = read(tree, split_file=tree / "all.csv", test=1).splits([FIRST, SECOND, RING])
    assert [listed.get(FIRST), sorted(listed.values())] == ["train", ["test", "train"]]
    with pytest.raises(
        MissingData, match=r"10 usable shapes .* shapes\.train=900 .*shapes\.limit"
    ):
        read(tree, train=900, test=1).splits(ids[:11])


def test_a_list_with_two_splits_of_one_model_is_told(tree: Path) -> None:
    with open(tree / "all.csv", "a") as file:
        file.write(f"9,{BOTTLE},{BOTTLE},{ANNOTATED},val\n")
    with pytest.raises(MissingData, match=rf"{FIRST} is in train and in val"):
        read(tree, split_file=tree / "all.csv")


def test_one_bad_annotation_is_left_out_and_listed(tree: Path, annotations: Path) -> None:
    path = annotations / "annotations" / "bottle.json"
    records = json.loads(path.read_text())
    records[1]["symmetries"]["reflection"][0]["kp_indexes"] = [1, 99]
    path.write_text(json.dumps(records))
    with pytest.warns(UserWarning, match=rf"1 annotations cannot .*{SECOND} \(IndexError"):
        shapes = read(tree, keypoints=annotations, annotated=True)
    assert shapes.ids() == [FIRST]
    assert shapes.keypoint_record(SECOND) is None


def test_a_limit_is_drawn_by_the_seed(tree: Path) -> None:
    drawn = {tuple(read(tree, limit=2, split_seed=seed).ids()) for seed in range(8)}
    assert {len(ids) for ids in drawn} == {2}
    assert len(drawn) > 1


def test_workers_get_no_lists_and_read_the_same(tree: Path, annotations: Path) -> None:
    shapes = read(tree, keypoints=annotations)
    copy = pickle.loads(pickle.dumps(shapes))
    assert copy.ids() == []
    assert np.array_equal(copy.mesh(RING).vertices, shapes.mesh(RING).vertices)
    assert copy.digest(FIRST) == shapes.digest(FIRST)


def test_a_changed_model_changes_the_fingerprint(tree: Path) -> None:
    before = read(tree).fingerprint
    path = tree / KNIFE / ("d" * 32) / "models" / "model_normalized.obj"
    path.write_text(path.read_text().replace("v ", "v 1", 1))
    assert read(tree).fingerprint != before


def test_raw_models_are_refused_where_they_are_learnt_from(tree: Path) -> None:
    with pytest.raises(Unsupported, match=r"stage=prepare shapes=shapenet .* shapes=folder"):
        ShapeNet(tree)


@pytest.mark.parametrize(
    ("text", "found"),
    [("{", "JSONDecodeError"), ('[{"model_id": "x"}]', "KeyError"), ("3", "TypeError")],
)
def test_damaged_annotations_are_told(
    tree: Path, annotations: Path, text: str, found: str
) -> None:
    (annotations / "annotations" / "bottle.json").write_text(text)
    with pytest.raises(MissingData, match=rf"bottle\.json: is no list .*{found}"):
        read(tree, keypoints=annotations, annotated=True)


def test_a_wrong_split_file_is_told(tree: Path) -> None:
    (tree / "all.csv").write_text("a,b\n1,2\n")
    with pytest.raises(MissingData, match=r"all\.csv: is no split list"):
        read(tree, split_file=tree / "all.csv")
