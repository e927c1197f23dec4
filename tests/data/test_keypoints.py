"""Keypoint records: symmetries, and models whose keypoints do not lie on them."""

from pathlib import Path

from layouts import ANNOTATED, BALL, SKEWED, keypoints, two_balls

from gensp.data.keypoints import symmetry_orbits
from gensp.data.shapes import ShapeCollection
from gensp.files import write_json, write_text
from gensp.geometry.mesh import save_mesh


def collection(root: Path) -> ShapeCollection:
    """Three balls, two of them annotated."""
    for id in (ANNOTATED, SKEWED, "bare"):
        save_mesh(BALL, root / "meshes" / f"{id}.ply")
    records = [keypoints(id, two_balls(0.3), 0.0) for id in (ANNOTATED, SKEWED)]
    write_json(root / "keypoints.json", records)
    return ShapeCollection.from_folder(root)


def test_groups_with_a_common_member_are_one_orbit() -> None:
    groups = [(1, 2), (3, 4), (5, 6), (2, 3), (7, 8)]
    assert sorted(symmetry_orbits(groups)) == [(1, 2, 3, 4), (5, 6), (7, 8)]
    assert symmetry_orbits([]) == []


def test_symmetries_are_told_where_any_shape_has_them(tmp_path: Path) -> None:
    found = collection(tmp_path / "with")
    assert found.symmetries(ANNOTATED) == [(5, 6)]
    assert found.symmetries("bare") == []
    save_mesh(BALL, tmp_path / "without" / "bare.ply")
    assert ShapeCollection.from_folder(tmp_path / "without").symmetries("bare") is None


def test_models_that_are_listed_as_misaligned_have_no_keypoints(tmp_path: Path) -> None:
    before = collection(tmp_path)
    assert before.keypoints(SKEWED) is not None
    fingerprint = before.fingerprint
    write_text(tmp_path / "misaligned.csv", f"id,keypoints_off\n{SKEWED},0.2\n")
    after = ShapeCollection.from_folder(tmp_path)
    assert after.keypoints(SKEWED) is None
    assert after.keypoints(ANNOTATED) is not None
    # What was evaluated with the others' keypoints is not taken for this.
    assert after.fingerprint != fingerprint
