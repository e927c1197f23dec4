"""Raw meshes to a collection: verdicts, tables, what is carried along, restarts."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import (
    ROOT,
    begun,
    environment,
    finished_items,
    kill_in_the_middle,
    run_here,
    train,
)
from compare import different
from layouts import (
    ANNOTATED,
    BALL,
    BOTTLE,
    KNIFE,
    SKEWED,
    write_dfaust,
    write_keypointnet,
    write_shapenet,
)
from test_bad_meshes import DEFECTS

from gensp import layout
from gensp.data.ground_truth import GroundTruth, save_ground_truth
from gensp.data.shapes import ShapeCollection
from gensp.errors import MissingData, OutputError, StaleRun, Unsupported
from gensp.geometry.mesh import SPHERE_AREA, Mesh, save_mesh
from gensp.geometry.points import sample_surface
from gensp.geometry.repair import STEPS

ALL = f"recipe.prepare.repair=[{','.join(STEPS)}]"
# What is wrong, and whether all kinds of mending but new triangles make it usable.
VERDICTS = {
    "open": ("3 boundary edges in 1 hole", "repaired"),
    "non_manifold": ("1 non-manifold edge", "repaired"),
    "pinched": ("1 non-manifold vertex", "repaired"),
    "flipped": ("3 misoriented edges", "repaired"),
    "inside_out": ("faces look inwards", "repaired"),
    "two_parts": ("2 components", "repaired"),
    "genus_one": ("genus 1", "dropped"),
    "nan": ("1 non-finite vertex", "repaired"),
    "zero_area": ("faces without area", "repaired"),
    "stray_vertex": ("1 vertex without a face", "repaired"),
    "flat": ("faces without area", "dropped"),
    "one_triangle": ("3 boundary edges in 1 hole", "dropped"),
    "garbage": ("", "dropped"),
    "truncated": ("", "dropped"),
    "empty": ("", "dropped"),
    "no_triangles": ("", "dropped"),
}


def words(raw: Path, out: Path, *more: str) -> tuple[str, ...]:
    places = (f"shapes.root={raw}", f"prepare.out={out}", f"paths.cache={out.parent / 'cache'}")
    return ("stage=prepare", "recipe=smoke", "workers.jobs=1", *places, "logger=none", *more)


def prepare(raw: Path, out: Path, *more: str, shapes: str = "folder") -> dict[str, dict]:
    """The rows of prepared.csv by id."""
    run_here(*words(raw, out, f"shapes={shapes}", *more))
    return {row["id"]: row for row in table(out / "prepared.csv")}


def made_differently(first: Path, second: Path) -> list[str]:
    """Files of two collections that differ, but for the rows, which tell what was kept."""
    found = different(first, second)
    return [name for name in found if not name.startswith(("rows/", "prepared.csv"))]


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def defects(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    """Every defect and a sound mesh, with all kinds of mending."""
    raw = tmp_path_factory.mktemp("raw")
    for name in VERDICTS:
        DEFECTS[name][0](raw / f"{name}.ply")
    save_mesh(BALL, raw / "sound.ply")
    return prepare(raw, raw.parent / f"{raw.name}-out" / "made", ALL)


@pytest.mark.parametrize("name", VERDICTS)
def test_every_defect_has_its_verdict(defects: dict[str, dict], name: str) -> None:
    found, verdict = VERDICTS[name]
    row = defects[name]
    assert row["verdict"] == verdict
    assert found in row["found"]
    assert bool(row["reason"]) == (verdict == "dropped")
    assert bool(row["done"]) == (verdict == "repaired")


def test_a_sound_mesh_is_usable(defects: dict[str, dict]) -> None:
    assert defects["sound"]["verdict"] == "usable"
    assert float(defects["sound"]["hausdorff"]) == 0


@pytest.fixture
def raw(tmp_path: Path, bumpy: Mesh, ellipsoid: Mesh, rng: np.random.Generator) -> Path:
    """Two sound meshes, one with ground truth, an open one, and one of two parts."""
    folder = tmp_path / "raw"
    save_mesh(bumpy, folder / "bumpy.ply")
    save_mesh(ellipsoid, folder / "ellipsoid.obj")
    save_mesh(Mesh(bumpy.vertices, bumpy.faces[1:]), folder / "open.off")
    DEFECTS["two_parts"][0](folder / "parts.ply")
    truth = GroundTruth("t", np.arange(30), sample_surface(bumpy.face_areas, 30, rng))
    save_ground_truth(folder / "corr" / "bumpy.npz", truth)
    columns = "file,split,category,licence,correspondence"
    rows = [
        "bumpy.ply,train,stone,CC0,corr/bumpy.npz",
        "ellipsoid.obj,val,egg,CC-BY,",
        "open.off,test,stone,CC0,",
        "parts.ply,train,stone,CC0,",
    ]
    (folder / "manifest.csv").write_text("\n".join([columns, *rows]) + "\n")
    return folder


def test_the_result_is_a_collection(raw: Path, tmp_path: Path, bumpy: Mesh) -> None:
    rows = prepare(raw, tmp_path / "out", "recipe.prepare.repair=[holes]")
    verdicts = {id: row["verdict"] for id, row in rows.items()}
    assert verdicts == {
        "bumpy": "usable",
        "ellipsoid": "usable",
        "open": "repaired",
        "parts": "dropped",
    }
    made = ShapeCollection.from_folder(tmp_path / "out")
    assert made.ids() == ["bumpy", "ellipsoid", "open"]
    assert [made.shape(id).split for id in made.ids()] == ["train", "val", "test"]
    assert made.columns("ellipsoid") == {"category": "egg", "licence": "CC-BY"}
    raw_truth = ShapeCollection.from_folder(raw, on_bad="keep").ground_truth("bumpy")
    truth = made.ground_truth("bumpy")
    assert truth.template == raw_truth.template == "stone"
    assert (truth.at.faces == raw_truth.at.faces).all()
    (dropped,) = table(tmp_path / "out" / "dropped.csv")
    assert dropped["reason"] == "2 components"
    assert dropped["remedy"] == "recipe.prepare.repair: add components"


def test_what_is_moved_carries_its_ground_truth(raw: Path, tmp_path: Path, bumpy: Mesh) -> None:
    more = ("recipe.prepare.vertices=300", "recipe.prepare.normalize=true")
    rows = prepare(raw, tmp_path / "out", *more)
    made = ShapeCollection.from_folder(tmp_path / "out")
    mesh, truth = made.mesh("bumpy"), made.ground_truth("bumpy")
    assert mesh.area == pytest.approx(SPHERE_AREA)
    assert "normalised" in rows["bumpy"]["done"]
    # Back from the normalised frame, the points lie where they were.
    scale = np.sqrt(bumpy.area / SPHERE_AREA)
    old = ShapeCollection.from_folder(raw, on_bad="keep").ground_truth("bumpy")
    places = old.at.on(bumpy.vertices, bumpy.faces)[np.isin(old.ids, truth.ids)]
    found = truth.at.on(mesh.vertices, mesh.faces) * scale
    shift = (places - found).mean(axis=0)
    diagonal = np.linalg.norm(np.ptp(bumpy.vertices, axis=0))
    assert np.linalg.norm(found + shift - places, axis=1).max() < 0.03 * diagonal
    assert 0 < float(rows["bumpy"]["truth_moved"]) < 0.03
    assert 0 < float(rows["bumpy"]["hausdorff"]) < 0.03


def test_a_second_pass_takes_what_is_kept(raw: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert {row["cached"] for row in prepare(raw, first, ALL).values()} == {"False"}
    assert {row["cached"] for row in prepare(raw, second, ALL).values()} == {"True"}
    assert made_differently(first, second) == []
    changed = Mesh(1.5 * BALL.vertices, BALL.faces)
    save_mesh(changed, raw / "ellipsoid.obj")
    with pytest.raises(
        StaleRun, match=r"the meshes of the collection, .* changed\); .*force=true"
    ):
        prepare(raw, second, ALL)
    cached = {id: row["cached"] for id, row in prepare(raw, second, ALL, "force=true").items()}
    assert cached == {id: str(id != "ellipsoid") for id in cached}


def test_damaged_keepings_are_made_again(raw: Path, tmp_path: Path) -> None:
    prepare(raw, tmp_path / "first", ALL)
    for path in (tmp_path / "cache" / "prepared").glob("*/*.npz"):
        path.write_bytes(path.read_bytes()[:100])
    rows = prepare(raw, tmp_path / "second", ALL)
    assert {row["cached"] for row in rows.values()} == {"False"}
    assert made_differently(tmp_path / "first", tmp_path / "second") == []


@pytest.mark.slow
def test_a_killed_preparation_goes_on(raw: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    kill_in_the_middle(folder, *words(raw, folder, "shapes=folder", ALL))
    assert begun(folder)
    assert not (folder / "manifest.json").exists(), "killed too late to be of use"
    kept = finished_items(folder)
    prepare(raw, folder, ALL)
    assert kept.items() <= finished_items(folder).items()
    prepare(raw, tmp_path / "whole", ALL, f"paths.cache={tmp_path / 'other'}")
    assert made_differently(folder, tmp_path / "whole") == []


@pytest.mark.slow
def test_two_workers_make_what_one_makes(raw: Path, tmp_path: Path) -> None:
    own = (ALL, "recipe.prepare.remesh=true")
    prepare(raw, tmp_path / "one", *own)
    prepare(raw, tmp_path / "two", *own, "workers.jobs=2", f"paths.cache={tmp_path / 'other'}")
    assert made_differently(tmp_path / "one", tmp_path / "two") == []


def test_annotations_that_cannot_be_read_are_listed_with_the_reason(tmp_path: Path) -> None:
    tree = write_shapenet(tmp_path / "tree")
    annotations = write_keypointnet(tmp_path / "annotations")
    path = annotations / "annotations" / "bottle.json"
    records = json.loads(path.read_text())
    broken = next(record for record in records if record["model_id"] == ANNOTATED)
    broken["symmetries"]["reflection"][0]["kp_indexes"] = [1, 99]
    path.write_text(json.dumps(records))
    solid = "recipe.prepare.solid={resolution: 32, vertices: 400}"
    with pytest.warns(UserWarning, match="1 annotations cannot be read"):
        prepare(
            tree, tmp_path / "out", f"shapes.keypoints={annotations}", solid, shapes="shapenet"
        )
    reasons = {row["id"]: row["reason"] for row in table(tmp_path / "out" / "misaligned.csv")}
    assert reasons[f"{BOTTLE}_{SKEWED}"] == "off the surface"
    assert reasons[f"{BOTTLE}_{ANNOTATED}"].startswith("cannot be read: IndexError")


def test_shapenet_becomes_a_collection(tmp_path: Path) -> None:
    tree = write_shapenet(tmp_path / "tree")
    annotations = write_keypointnet(tmp_path / "annotations")
    solid = "recipe.prepare.solid={resolution: 48, vertices: 600}"
    more = (f"shapes.keypoints={annotations}", solid, "recipe.prepare.normalize=false")
    rows = prepare(tree, tmp_path / "out", *more, "shapes.test_fraction=0.5", shapes="shapenet")
    first, second = f"{BOTTLE}_{ANNOTATED}", f"{BOTTLE}_{SKEWED}"
    made = ShapeCollection.from_folder(tmp_path / "out")
    assert made.ids() == [first, second]
    assert sorted(made.shape(id).split for id in made.ids()) == ["test", "train"]
    assert made.columns(first)["category"] == "bottle"
    reasons = {row["id"]: row["reason"] for row in table(tmp_path / "out" / "dropped.csv")}
    assert "does not exist" in reasons[f"{BOTTLE}_{'c' * 32}"]
    assert reasons[f"{KNIFE}_{'d' * 32}"].startswith("genus 1 is left after remeshing")
    assert rows[first]["done"] == "outer surface"
    # Of two balls the outer surface alone is left: their union, 0.95 long and 0.6 wide.
    assert np.ptp(made.mesh(first).vertices, axis=0) == pytest.approx([0.95, 0.6, 0.6], abs=0.03)
    assert [row["id"] for row in table(tmp_path / "out" / "misaligned.csv")] == [second]
    assert made.keypoints(second) is None
    keypoints = made.keypoints(first)
    assert keypoints.ids.tolist() == [4, 5, 6]
    mesh = made.mesh(first)
    (record,) = json.loads((tmp_path / "out" / "keypoints.json").read_text())
    assert record["symmetries"]["reflection"] == [{"kp_indexes": [1, 2]}]
    places = keypoints.at.on(mesh.vertices, mesh.faces)
    expected = [BALL.vertices[BALL.faces[face, 0]] * 0.3 for face in (0, 60, 200)]
    assert np.abs(places - expected).max() < 0.05


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, dict]]:
    """Six models as ShapeNet stores them, prepared by what shapes=shapenet says."""
    tree, out = ROOT / "tests" / "fixtures", tmp_path_factory.mktemp("six") / "made"
    annotated = f"shapes.keypoints={tree / 'KeypointNet'}"
    coarse = "recipe.prepare.solid={resolution: 64, vertices: 1500}"
    cut = ("shapes.train=4", "shapes.test=1")
    shapes = prepare(tree / "ShapeNetCore.v2", out, annotated, coarse, *cut, shapes="shapenet")
    return out, shapes


def test_models_as_shapenet_stores_them_become_closed_surfaces(
    six: tuple[Path, dict[str, dict]],
) -> None:
    out, rows = six
    assert len(rows) == 6
    assert {row["verdict"] for row in rows.values()} == {"repaired"}
    assert {row["done"] for row in rows.values()} == {"outer surface; normalised"}
    assert table(out / "dropped.csv") == []
    assert all(int(row["keypoints"]) > 0 for row in rows.values())
    assert not (out / "misaligned.csv").exists()


def test_the_collection_holds_as_many_as_are_asked_for(
    six: tuple[Path, dict[str, dict]],
) -> None:
    made = ShapeCollection.from_folder(six[0])
    assert sorted(made.shape(id).split for id in made.ids()) == ["test"] + ["train"] * 4
    assert made.mesh(made.ids()[0]).area == pytest.approx(SPHERE_AREA)


def test_dfaust_gets_triangles_of_its_own(tmp_path: Path) -> None:
    root = write_dfaust(tmp_path / "raw", frames=2)
    frames = ("shapes.train=null", "shapes.test=null", "shapes.test_subjects=['50020']")
    prepare(root, tmp_path / "out", *frames, shapes="dfaust")
    made = ShapeCollection.from_folder(tmp_path / "out")
    assert made.ids("test") == ["50020_knees_00000", "50020_knees_00001"]
    first, second = "50004_hips_00000", "50002_hips_00000"
    meshes = made.mesh(first), made.mesh(second)
    assert len(meshes[0].vertices) != len(meshes[1].vertices)
    truths = [made.ground_truth(id) for id in (first, second)]
    for truth, mesh in zip(truths, meshes, strict=True):
        assert truth.template == "dfaust"
        places = truth.at.on(mesh.vertices, mesh.faces)
        assert np.linalg.norm(places - BALL.vertices[truth.ids], axis=1).max() < 0.02 * 2 * 3**0.5


def test_nothing_but_its_own_folder_is_written_over(raw: Path, tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=r"prepare\.out=.* holds shapes\.root"):
        prepare(raw, raw.parent, "force=true")
    with pytest.raises(Unsupported, match=r"prepare\.out=.* is within shapes\.root"):
        prepare(raw, raw / "made")
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match=r"mine: is not empty .* name one that does not exist"):
        prepare(raw, mine, "force=true")
    assert (mine / "thesis.txt").read_text() == "years of work"


def test_a_collection_without_a_usable_mesh_is_told(tmp_path: Path) -> None:
    DEFECTS["genus_one"][0](tmp_path / "raw" / "ring.ply")
    with pytest.raises(MissingData, match=r"none of 1 meshes can .* genus 1; .*dropped\.csv"):
        prepare(tmp_path / "raw", tmp_path / "out")


DEADLY = ("shapes._target_=trying.Deadly.from_folder", "workers.jobs=2")


def test_meshes_that_kill_their_workers_are_dropped(raw: Path, tmp_path: Path) -> None:
    """And those that lead to an error of the program; the others become a collection."""
    for name in ("deadly", "raising"):
        save_mesh(BALL, raw / f"{name}.ply")
    with open(raw / "manifest.csv", "a") as file:
        file.write("deadly.ply,train,stone,CC0,\nraising.ply,train,stone,CC0,\n")
    out = tmp_path / "out"
    with pytest.warns(UserWarning, match="a worker died; its items are done again"):
        rows = prepare(raw, out, *DEADLY)
    verdicts = {id: row["verdict"] for id, row in rows.items()}
    assert verdicts == {
        **{"bumpy": "usable", "ellipsoid": "usable", "open": "dropped", "parts": "dropped"},
        **{"deadly": "dropped", "raising": "dropped"},
    }
    reasons = {row["id"]: row["reason"] for row in table(out / "dropped.csv")}
    assert reasons["deadly"].startswith("its worker process died 2 times")
    assert "IndexError: index 7 is out of bounds; trying.py" in reasons["raising"]
    assert ShapeCollection.from_folder(out).ids() == ["bumpy", "ellipsoid"]
    metrics = json.loads((out / "manifest.json").read_text())["metrics"]
    assert metrics["failed"] == 2
    assert list(metrics)[:4] == ["kept", "repaired", "dropped", "failed"]
    assert [metrics[name] for name in ("kept", "dropped", "items")] == [2, 4, 6]
    again = prepare(raw, out, "workers.jobs=2", "force=true")
    assert again["deadly"]["verdict"] == again["raising"]["verdict"] == "usable"
    assert "error" not in again["deadly"]


def test_a_collection_of_deadly_meshes_alone_is_told(tmp_path: Path) -> None:
    save_mesh(BALL, tmp_path / "raw" / "raising.ply")
    with pytest.raises(MissingData, match=r"none of 1 meshes .* an unexpected error was met"):
        prepare(tmp_path / "raw", tmp_path / "out", *DEADLY)


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (("stage=augment", "shapes.on_bad=keep"), "stage=augment; stage=prepare sets keep"),
        (("stage=prepare", "shapes.on_bad=skip"), "on_bad=skip: was found with stage=prepare"),
        (("stage=prepare", "recipe.prepare.repair=[heal]"), "'heal' is no kind of mending"),
    ],
)
def test_words_that_would_be_ignored_are_refused(
    raw: Path, tmp_path: Path, more: tuple[str, ...], line: str
) -> None:
    with pytest.raises(Unsupported, match=line):
        run_here(*words(raw, tmp_path / "out", "shapes=folder")[1:], *more)


@pytest.mark.parametrize("shapes", ["shapenet", "dfaust"])
def test_raw_collections_name_the_command_that_prepares_them(shapes: str, tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=rf"stage=prepare shapes={shapes} shapes\.root="):
        run_here("stage=augment", f"shapes={shapes}", f"shapes.root={tmp_path}")


def test_surfaces_that_pass_through_themselves_are_counted(tmp_path: Path) -> None:
    inside = np.array(BALL.vertices)
    inside[3] = -1.5 * inside[3]
    save_mesh(BALL, tmp_path / "raw" / "ball.ply")
    save_mesh(BALL.with_vertices(inside), tmp_path / "raw" / "crossing.ply")
    rows = prepare(tmp_path / "raw", tmp_path / "out")
    assert rows["ball"]["self_intersecting_before"] == "0"
    count = int(rows["crossing"]["self_intersecting_before"])
    assert count > 5
    card = (tmp_path / "out" / "CARD.md").read_text()
    assert f"| usable | 1 | 2 | {count} to {count}, median {count} |" in card


def test_a_finished_stage_is_kept_without_loading_what_computes(raw: Path, tmp_path: Path) -> None:
    """One command for several collections; the second time no geometry is loaded."""
    shutil.copytree(raw, tmp_path / "data" / "one")
    shutil.copytree(raw, tmp_path / "data" / "two")
    places = (f"shapes.root={tmp_path}/data/${{shapes.name}}", f"paths.cache={tmp_path}/cache")
    task = ("-m", "stage=prepare", "recipe=smoke", "shapes=folder", "shapes.name=one,two")
    task = (*task, *places, f"prepare.out={tmp_path}/made/${{shapes.name}}", "logger=none")
    train(*task, "workers.jobs=1")
    made = {path.parent.name for path in (tmp_path / "made").glob("*/manifest.json")}
    assert made == {"one", "two"}
    again = subprocess.run(
        [sys.executable, "-X", "importtime", "train.py", *task],
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert again.stdout.count("finished before, kept") == 2
    loaded = {line.rsplit("|", 1)[-1].strip().split(".")[0] for line in again.stderr.splitlines()}
    assert "hydra" in loaded
    assert not loaded & {"torch", "lightning", "igl", "trimesh", "scipy", "numba", "matplotlib"}


def test_a_collection_in_many_folders_is_read_as_one(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare(raw, tmp_path / "one")
    monkeypatch.setattr(layout, "MOST", 1)
    prepare(raw, tmp_path / "many")
    one, many = (ShapeCollection.from_folder(tmp_path / name) for name in ("one", "many"))
    assert many.ids() == one.ids()
    for id in one.ids():
        assert many.shape(id).path.relative_to(tmp_path / "many" / "meshes").parent.name
        np.testing.assert_array_equal(many.mesh(id).vertices, one.mesh(id).vertices)
    truths = [collection.ground_truth("bumpy") for collection in (one, many)]
    np.testing.assert_array_equal(truths[0].ids, truths[1].ids)
