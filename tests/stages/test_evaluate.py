"""The evaluation of maps whose figures are known."""

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from lightning import Trainer
from scipy.spatial.transform import Rotation

from gensp.benchmark import Benchmark
from gensp.compute import run_items
from gensp.data.folder import Shape
from gensp.data.ground_truth import GroundTruth, save_ground_truth
from gensp.data.modules import ItemsModule
from gensp.data.shapes import ShapeCollection
from gensp.errors import MissingData
from gensp.files import save_npz, write_json
from gensp.geometry.implied import frame_error
from gensp.geometry.mesh import Mesh, normalize, save_mesh
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap, save_map
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.stages.base import write_table
from gensp.stages.evaluate import EvaluateStage
from gensp.stages.summary import summarize, without_nan
from gensp.tables import summary_markdown
from gensp.tasks.evaluate import Evaluate, evaluate_items, evaluate_task, map_path
from gensp.tasks.pairs import EvaluatedMap, frame_record, pair_records

TURN = Rotation.from_rotvec([0.1, 0.6, -0.3]).as_matrix()
NAMES = {"experiment": "test", "variant": "full", "method": "gensp"}
# Two ground-truth shapes to train on, one turned on the sphere to test with, one without.
SHAPES = ("bumpy", "ellipsoid", "dumbbell", "lonely")


@pytest.fixture
def collection(
    tmp_path: Path, bumpy: Mesh, ellipsoid: Mesh, dumbbell: Mesh, rng: np.random.Generator
) -> ShapeCollection:
    root = tmp_path / "shapes"
    at = sample_surface(np.ones(len(bumpy.faces)), 400, rng)
    lines = ["file,category,split,correspondence"]
    for mesh, split in ((bumpy, "train"), (ellipsoid, "train"), (dumbbell, "test")):
        save_mesh(mesh, root / f"{mesh.name}.ply")
        truth = GroundTruth("ball", np.arange(400), at)
        save_ground_truth(root / "corr" / f"{mesh.name}.npz", truth)
        lines.append(f"{mesh.name}.ply,ball,{split},corr/{mesh.name}.npz")
    save_mesh(ellipsoid.with_vertices(2 * ellipsoid.vertices), root / "lonely.ply")
    save_mesh(Mesh(bumpy.vertices, bumpy.faces[1:]), root / "open.ply")
    lines += ["lonely.ply,other,test,", "open.ply,other,test,"]
    (root / "manifest.csv").write_text("\n".join(lines) + "\n")
    return ShapeCollection.from_folder(root, name="four", on_bad="skip")


@pytest.fixture
def maps(tmp_path: Path, collection: ShapeCollection) -> Run:
    folder = tmp_path / "parameterize"
    for id in SHAPES:
        mesh = collection.mesh(id)
        sphere = icosphere(3).vertices @ (TURN.T if id == "dumbbell" else np.eye(3))
        save_map(SphericalMap(sphere, mesh.vertices, mesh.faces, id), folder / "maps")
        write_json(folder / "rows" / f"{id}.json", {"id": id, "seconds": 2.0})
    for id in ("bumpy", "ellipsoid"):
        shape = normalize(collection.mesh(id)).vertices
        path = folder / "predictions" / f"{id}.npz"
        save_npz(path, generated=0.9 * shape, fitted=shape, code=np.zeros(2))
    write_json(folder / "rows" / "gone.json", {"id": "gone", "error": "gone: not embeddable"})
    return Run(folder)


@pytest.fixture
def evaluated(tmp_path: Path, collection: ShapeCollection, maps: Run) -> tuple[Path, dict]:
    folder = tmp_path / "evaluate"
    return folder, evaluate(folder, maps, collection)


@pytest.fixture
def unknown(tmp_path: Path, collection: ShapeCollection) -> ShapeCollection:
    """The same shapes in a folder that knows no ground truth."""
    for id in SHAPES:
        save_mesh(collection.mesh(id), tmp_path / "unknown" / f"{id}.ply")
    return ShapeCollection.from_folder(tmp_path / "unknown", name="folder")


def evaluate(folder: Path, maps: Run, collection: ShapeCollection) -> dict[str, float]:
    inputs = {"parameterize": maps}
    data = ItemsModule.from_runs(
        inputs,
        folder,
        task=partial(evaluate_task, collection=collection, level=4, samples=2000),
        items=partial(evaluate_items, collection=collection),
        workers=Workers(jobs=1, backend="sequential"),
    )
    stage = EvaluateStage.from_runs(inputs, folder, collection=collection, names=NAMES)
    trainer = Trainer(
        logger=False, enable_checkpointing=False, accelerator="cpu", enable_progress_bar=False
    )
    trainer.predict(stage, datamodule=data, return_predictions=False)
    return stage.finish()


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_maps_that_agree_have_no_error_and_turned_ones_none_after_rotation(
    evaluated: tuple[Path, dict],
) -> None:
    pairs = {(row["first"], row["second"]): row for row in table(evaluated[0] / "pairs.csv")}
    assert {frozenset(pair) for pair in pairs} == {
        frozenset(pair)
        for pair in (("bumpy", "ellipsoid"), ("bumpy", "dumbbell"), ("ellipsoid", "dumbbell"))
    }
    for pair, row in pairs.items():
        turned = "dumbbell" in pair
        assert row["group"] == ("mixed" if turned else "train")
        assert row["points"] == "400"
        assert float(row["error_rotated"]) < 1e-9
        # Registration knows no ground truth, so it cannot do better than the best rotation.
        assert float(row["error_registered"]) > float(row["error_rotated"])
        assert float(row["c_area_rotated"]) < 1e-7
        assert (float(row["error"]) > 0.05) == turned
        assert (float(row["c"]) > 0.05) == turned
        # What the maps were read off is known of two shapes, and meets them exactly.
        assert (row["error_prediction"] == "") == turned
        assert turned or float(row["error_prediction"]) < 1e-9


def test_rows_hold_what_is_known_of_each_map(
    evaluated: tuple[Path, dict], collection: ShapeCollection
) -> None:
    rows = {row["id"]: row for row in table(evaluated[0] / "shapes.csv")}
    assert list(rows) == list(SHAPES)
    for id, row in rows.items():
        assert float(row["sigma_mean"]) >= 1
        assert float(row["sigma_max"]) >= float(row["sigma_mean"])
        assert row["bad_faces"] == "0"
        assert row["degree"] == "1"
        assert float(row["seconds"]) == 2
        # The remesh is finer than the mesh, so it leaves out corners only.
        assert float(row["coverage_mean"]) < 0.01
        assert (row["error"] == "") == (id == "lonely")
    assert rows["lonely"]["template"] == ""
    # An even shrink by a tenth, measured from the shape's own centre.
    mesh = normalize(collection.mesh("bumpy"))
    reach = 0.1 * np.linalg.norm(mesh.vertices, axis=1).max() / np.sqrt(mesh.area)
    assert 0.5 * reach < float(rows["bumpy"]["prediction_coverage_max"]) <= reach


def test_summary_groups_splits_and_lists_what_is_missing(evaluated: tuple[Path, dict]) -> None:
    folder, metrics = evaluated
    summary = json.loads((folder / "summary.json").read_text())
    assert list(summary["groups"]) == ["train", "test", "all"]
    train, test, everything = summary["groups"].values()
    assert (train["shapes"], test["shapes"], everything["shapes"]) == (2, 2, 4)
    assert (train["pairs"], test["pairs"], everything["pairs"]) == (1, 0, 3)
    assert train["error"] < 1e-9
    assert "error" not in test
    assert everything["error_median"] > 0
    assert everything["affected_shapes"] == 0
    assert [entry["id"] for entry in summary["skipped"]] == ["open"]
    assert "boundary edges" in summary["skipped"][0]["reason"]
    assert summary["failed"] == [{"id": "gone", "error": "gone: not embeddable"}]
    assert next(iter(metrics)) == "test/sigma_mean"
    assert metrics["all/error"] == pytest.approx(everything["error"])
    curve = summary["curves"]["train"]["raw"]
    assert curve[1] == 1
    curves = summary["curves"]["all"]
    rotated, raw = (np.array(curves[key]) for key in ("rotated", "raw"))
    assert (np.diff(raw) >= 0).all()
    assert (rotated >= raw)[1:].all()
    assert (rotated >= np.array(curves["registered"]))[1:].all()
    text = (folder / "summary.md").read_text()
    assert "open" in text
    assert "gone" in text
    assert len(table(folder / "summary.csv")) == 3


def test_without_ground_truth_c_is_of_the_places_themselves(
    unknown: ShapeCollection, maps: Run, tmp_path: Path
) -> None:
    metrics = evaluate(tmp_path / "out", maps, unknown)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = summary["groups"]["all"]
    assert found["c_frame"] == metrics["all/c_frame"] > 0
    assert {"c_frame_registered", "c_frame_area", "c_frame_area_registered"} <= found.keys()
    assert found["frame_pairs"] == found["frame_neighbour_pairs"] == 6
    assert found["pairs"] == found["keypoint_pairs"] == 0
    assert not {"c", "error", "geodesic", "keypoint_error"} & found.keys()
    # "folder" is the name of all of them: the run's is told.
    assert summary["collection"] == NAMES["experiment"]
    text = (tmp_path / "out" / "summary.md").read_text()
    assert "| c (frame) | c (frame, registered) | c (frame, area) | bad faces % |" in text
    assert "pairs (frame)" in Benchmark((summary,)).markdown()


def test_with_ground_truth_no_pair_is_measured_without(evaluated: tuple[Path, dict]) -> None:
    assert {row["kind"] for row in table(evaluated[0] / "pairs.csv")} == {"dense"}
    groups = json.loads((evaluated[0] / "summary.json").read_text())["groups"]
    assert not [key for group in groups.values() for key in group if "frame" in key]


def test_c_without_ground_truth_is_what_maps_say_against_how_far_shapes_are_apart(
    bumpy: Mesh, ellipsoid: Mesh
) -> None:
    ball = icosphere(3)
    maps = [
        SphericalMap(ball.vertices, normalize(mesh).vertices, mesh.faces)
        for mesh in (bumpy, ellipsoid)
    ]
    record = frame_record(*map(EvaluatedMap, maps))
    # Both maps have one sphere: the same corners and weights on either surface.
    at = sample_surface(ball.face_areas, 20_000, np.random.default_rng(3))
    between = at.on(maps[0].surface - maps[1].surface, ball.faces)
    expected = np.linalg.norm(between, axis=1).mean() / record["hausdorff"]
    assert record["c_frame"] == pytest.approx(expected, rel=0.03)
    back = frame_record(*map(EvaluatedMap, maps[::-1]))
    for key in ("hausdorff", "c_frame", "c_frame_area", "c_frame_registered"):
        assert back[key] == pytest.approx(record[key], rel=1e-6)


def test_a_copy_of_a_shape_has_no_error_in_the_frame_but_no_c(bumpy: Mesh) -> None:
    map = SphericalMap(icosphere(3).vertices, bumpy.vertices, bumpy.faces)
    at = sample_surface(bumpy.face_areas, 100, np.random.default_rng(0))
    assert frame_error(map, map, at).max() < 1e-9
    assert frame_error(map, map.rotated(TURN), at, TURN).max() < 1e-9
    assert frame_error(map, map.rotated(TURN), at).mean() > 0.05
    record = frame_record(EvaluatedMap(map), EvaluatedMap(map))
    assert np.isnan(record["c_frame"])


def test_registered_c_without_ground_truth_does_not_see_rotations(bumpy: Mesh) -> None:
    ball = icosphere(3).vertices
    grown = bumpy.with_vertices(bumpy.vertices * np.where(ball[:, :1] > 0.4, 1.1, 1))
    other = EvaluatedMap(SphericalMap(ball, grown.vertices, grown.faces))
    still = SphericalMap(ball, bumpy.vertices, bumpy.faces)
    before = frame_record(EvaluatedMap(still), other)
    after = frame_record(EvaluatedMap(still.rotated(TURN)), other)
    assert after["c_frame"] > 2 * before["c_frame_registered"]
    assert after["c_frame_registered"] == pytest.approx(before["c_frame_registered"], rel=0.05)
    assert after["c_frame_area_registered"] == pytest.approx(
        before["c_frame_area_registered"], rel=1e-3
    )


@pytest.mark.parametrize(
    ("partners", "truth", "pairs"),
    [(None, False, 20 * 12 / 2), (None, True, 20 * 19 / 2), (4, False, 20 * 4 / 2)],
)
def test_without_ground_truth_a_shape_is_compared_with_a_few(
    partners: int | None, truth: bool, pairs: int, tmp_path: Path
) -> None:
    known = tmp_path / "known.npz" if truth else None
    shapes = [Shape(str(k), tmp_path / f"{k}.ply", correspondence=known) for k in range(20)]
    collection = ShapeCollection("twenty", shapes, on_bad="keep")
    work = Evaluate(tmp_path, tmp_path, collection, partners=partners)
    for id in collection.ids():
        map_path(tmp_path, id).parent.mkdir(exist_ok=True)
        map_path(tmp_path, id).touch()
    found = [{id, other} for id in collection.ids() for other in work._partners(id)]
    assert len(found) == len({frozenset(pair) for pair in found}) == pairs


def test_summary_names_shapes_that_no_registration_reached(
    collection: ShapeCollection, maps: Run, tmp_path: Path
) -> None:
    rows = [
        {"id": "bumpy", "depth": 1},
        {"id": "ellipsoid", "error": "no registration reached it"},
    ]
    correspond = Run(tmp_path / "correspond")
    write_table(correspond.folder / "shapes.csv", rows)
    inputs, folder = {"parameterize": maps, "correspond": correspond}, tmp_path / "evaluate"
    task = Evaluate(maps.folder, folder, collection, level=3, samples=100)
    list(run_items(task, SHAPES, folder, Workers(jobs=1)))
    EvaluateStage.from_runs(inputs, folder, collection=collection, names=NAMES).finish()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["lost"] == [{"id": "ellipsoid", "reason": "no registration reached it"}]
    text = (folder / "summary.md").read_text()
    assert "## Not learnt from\n\n- ellipsoid: no registration reached it" in text


def test_bad_faces_and_collapsed_triangles_are_counted(
    collection: ShapeCollection, maps: Run, tmp_path: Path
) -> None:
    sphere = icosphere(3).vertices.copy()
    # A vertex moved across the opposite edge folds faces over.
    sphere[200] = -sphere[200]
    mesh = collection.mesh("bumpy")
    save_map(SphericalMap(sphere, mesh.vertices, mesh.faces, "bumpy"), maps.folder / "maps")
    row = Evaluate(maps.folder, tmp_path / "out", collection, level=3, samples=500)("bumpy")
    assert row["bad_faces"] > 0
    assert row["bad_faces_percent"] == pytest.approx(100 * row["bad_faces"] / len(mesh.faces))
    summary = summarize([row], [], NAMES, 6)
    assert summary["groups"]["all"]["affected_shapes"] == 1


def test_pair_of_other_templates_is_compared_at_keypoints(
    bumpy: Mesh, ellipsoid: Mesh, rng: np.random.Generator
) -> None:
    ball = icosphere(3).vertices
    at = sample_surface(bumpy.face_areas, 9, rng)
    keypoints = GroundTruth("keypoints", np.arange(9), at)
    truths = [GroundTruth(name, np.arange(9), at) for name in ("cow", "fox")]
    one, other = (
        EvaluatedMap(SphericalMap(ball, mesh.vertices, mesh.faces), truth, keypoints)
        for mesh, truth in zip((bumpy, ellipsoid), truths, strict=True)
    )
    (record,) = pair_records(one, other)
    assert record["kind"] == "keypoints"
    assert record["points"] == 9
    assert record["error"] < 1e-9
    assert pair_records(one, EvaluatedMap(other.map)) == []


def keypoint_pair(symmetries: tuple[object, object]) -> dict:
    """Ellipsoids whose second map is turned by half about their own axis of symmetry."""
    ball = icosphere(3)
    turn = np.diag([-1.0, -1.0, 1.0])
    places = {tuple(np.round(v, 6)): k for k, v in enumerate(ball.vertices)}
    one, pole = 7, int(np.argmax(ball.vertices[:, 2]))
    vertices = [one, places[tuple(np.round(turn @ ball.vertices[one], 6))], pole]
    faces, corners = zip(*(np.argwhere(ball.faces == v)[0] for v in vertices), strict=True)
    keypoints = GroundTruth(
        "keypoints", np.array([4, 9, 2]), SurfacePoints(np.array(faces), np.eye(3)[list(corners)])
    )
    surface = ball.vertices * np.array([1.5, 0.8, 0.6])
    spheres = (ball.vertices, ball.vertices @ turn.T)
    maps = [SphericalMap(sphere, surface, ball.faces) for sphere in spheres]
    shapes = [
        EvaluatedMap(map, None, keypoints, symmetries=groups)
        for map, groups in zip(maps, symmetries, strict=True)
    ]
    (record,) = pair_records(*shapes)
    moved = np.linalg.norm(2 * shapes[0].map.surface[one][:2])
    return record | {"expected": 2 / 3 * moved / np.sqrt(shapes[0].map.mesh.area)}


def test_keypoints_that_a_symmetry_exchanges_may_be_exchanged() -> None:
    known = keypoint_pair(([(4, 9)], [(4, 9)]))
    assert known["error"] == pytest.approx(known["expected"], rel=1e-6)
    assert known["error_symmetric"] < 1e-9
    # The shape that a point is carried to tells its symmetries: one of both directions has any.
    half = keypoint_pair(([(4, 9)], []))
    assert half["error_symmetric"] == pytest.approx(half["expected"] / 2, rel=1e-6)
    # The pole belongs to no group, and points of a group are not all taken to the nearest.
    none = keypoint_pair(([(4, 2)], [(4, 2)]))
    assert none["error_symmetric"] <= none["error"]
    assert none["error_symmetric"] > known["expected"] / 3
    assert "error_symmetric" not in keypoint_pair((None, None))


def test_the_symmetric_error_has_a_column_beside_the_plain_one() -> None:
    pair = keypoint_pair(([(4, 9)], [(4, 9)])) | {"first": "a", "second": "b", "group": "train"}
    rows = [
        {"id": id, "split": "train", "bad_faces": 0, "faces": 9, "degree": 1} for id in ("a", "b")
    ]
    summary = summarize(rows, [pair], NAMES, 6)
    found = summary["groups"]["train"]
    assert found["keypoint_error"] == pytest.approx(pair["error"])
    assert found["keypoint_error_symmetric"] < 1e-9
    text = summary_markdown(summary)
    assert "| keypoints | keypoints (symmetric) |" in text


def test_pair_figures_are_symmetric(
    bumpy: Mesh, ellipsoid: Mesh, rng: np.random.Generator
) -> None:
    at = sample_surface(bumpy.face_areas, 200, rng)
    truth = GroundTruth("ball", np.arange(200), at)
    ball = icosphere(3).vertices
    one = EvaluatedMap(SphericalMap(ball, bumpy.vertices, bumpy.faces), truth)
    other = EvaluatedMap(SphericalMap(ball @ TURN.T, ellipsoid.vertices, ellipsoid.faces), truth)
    ahead, back = pair_records(one, other)[0], pair_records(other, one)[0]
    for key in ("error", "error_max", "hausdorff", "c", "c_area"):
        assert ahead[key] == pytest.approx(back[key], rel=1e-9)
    assert ahead["error_registered"] == pytest.approx(back["error_registered"], rel=1e-6)
    # Scale and position of the input do not matter.
    moved = bumpy.with_vertices(7 * bumpy.vertices + np.array([3.0, -2, 1]))
    shifted = EvaluatedMap(SphericalMap(ball, moved.vertices, moved.faces), truth)
    again = pair_records(shifted, other)[0]
    for key in ("error", "error_rotated", "error_registered", "c", "c_area_rotated"):
        assert again[key] == pytest.approx(ahead[key], rel=1e-6)


def test_registered_figures_do_not_see_the_rotations_of_the_maps(
    bumpy: Mesh, rng: np.random.Generator
) -> None:
    truth = GroundTruth("ball", np.arange(200), sample_surface(bumpy.face_areas, 200, rng))
    ball = icosphere(3).vertices
    # The same shape with more of one bump.
    grown = bumpy.with_vertices(bumpy.vertices * np.where(ball[:, :1] > 0.4, 1.1, 1))
    still, other = (
        EvaluatedMap(SphericalMap(ball, m.vertices, m.faces), truth) for m in (bumpy, grown)
    )
    turned = EvaluatedMap(SphericalMap(ball @ TURN.T, bumpy.vertices, bumpy.faces), truth)
    before, after = pair_records(still, other)[0], pair_records(turned, other)[0]
    assert after["error"] > 5 * before["error_registered"]
    for key in ("error_registered", "c_area_registered"):
        assert after[key] == pytest.approx(before[key], rel=1e-5)
    # The samples of c are drawn on the sphere, which does not turn with the map.
    assert after["c_registered"] == pytest.approx(before["c_registered"], rel=0.02)


def test_ground_truth_of_another_mesh_is_refused(
    collection: ShapeCollection, maps: Run, tmp_path: Path
) -> None:
    at = SurfacePoints(np.array([5000]), np.full((1, 3), 1 / 3))
    truth = collection.shape("bumpy").correspondence
    assert truth is not None
    save_ground_truth(truth, GroundTruth("ball", np.array([0]), at))
    with pytest.raises(MissingData, match=r"ground truth names face 5000.*entry of bumpy"):
        Evaluate(maps.folder, tmp_path / "out", collection)("bumpy")


def test_no_maps_names_the_stage(collection: ShapeCollection, tmp_path: Path) -> None:
    inputs = {"parameterize": Run(tmp_path / "nothing")}
    with pytest.raises(MissingData, match=r"holds no map of collection four.*stage=parameterize"):
        evaluate_items(inputs, tmp_path, collection=collection)


def test_json_has_null_for_what_is_not_finite() -> None:
    found = without_nan({"a": [1.0, np.inf], "b": {"c": np.nan, "d": 2}})
    assert found == {"a": [1.0, None], "b": {"c": None, "d": 2}}
