"""The generated family: sound shapes, ground truth, reproducible."""

from pathlib import Path

import igl.predicates
import numpy as np
import pytest

from gensp.data.blobs import BlobFamily, generate_blobs
from gensp.data.ground_truth import common_points
from gensp.data.shapes import ShapeCollection
from gensp.errors import Unsupported
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import require_genus_zero

FAMILY = {"count": 4, "vertices": 400, "test": 1}


@pytest.fixture(scope="module")
def blobs(tmp_path_factory: pytest.TempPathFactory) -> ShapeCollection:
    return ShapeCollection.from_blobs(tmp_path_factory.mktemp("blobs"), **FAMILY)


def test_blobs_are_embedded_spheres_with_their_own_triangulations(
    blobs: ShapeCollection,
) -> None:
    assert len(blobs.ids("train")) == 3
    assert len(blobs.ids("test")) == 1
    sizes = set()
    for id in blobs.ids():
        mesh = blobs.mesh(id)
        require_genus_zero(mesh)
        assert not igl.predicates.find_self_intersections(mesh.vertices, mesh.faces, True)[0]
        assert 350 < len(mesh.vertices) < 450
        sizes.add(len(mesh.vertices))
    assert len(sizes) > 1


def test_ground_truth_keeps_neighbours_together(blobs: ShapeCollection) -> None:
    # Points that are close on one shape are close on the other: the map between them is smooth.
    first, second = blobs.ids()[:2]
    truths = [blobs.ground_truth(id) for id in (first, second)]
    assert truths[0] is not None
    assert truths[1] is not None
    rows, others = common_points(truths[0], truths[1])
    meshes = [blobs.mesh(id) for id in (first, second)]
    x = truths[0].at.take(rows).on(meshes[0].vertices, meshes[0].faces)
    y = truths[1].at.take(others).on(meshes[1].vertices, meshes[1].faces)
    assert closest_point(x, meshes[0]).distance.max() < 1e-9
    nearest = np.argsort(np.linalg.norm(x[:, None] - x[None], axis=2), axis=1)[:, 1]
    stretch = np.linalg.norm(y - y[nearest], axis=1) / np.linalg.norm(x - x[nearest], axis=1)
    assert np.quantile(stretch, 0.95) < 4
    assert len(rows) == len(truths[0].ids)


def test_the_same_settings_give_the_same_files(tmp_path: Path) -> None:
    family = BlobFamily(count=2, vertices=300)
    one, other = (generate_blobs(tmp_path / name, family) for name in ("a", "b"))
    assert one.name == other.name
    files = [path.relative_to(one) for path in sorted(one.rglob("*.ply"))]
    assert len(files) == 2
    for file in files:
        assert (one / file).read_bytes() == (other / file).read_bytes()
    assert generate_blobs(tmp_path / "a", BlobFamily(count=2, vertices=300, seed=1)) != one


def test_finished_families_are_not_made_again(tmp_path: Path) -> None:
    family = BlobFamily(count=2, vertices=300)
    root = generate_blobs(tmp_path, family)
    before = (root / "manifest.csv").stat().st_mtime_ns
    assert generate_blobs(tmp_path, family) == root
    assert (root / "manifest.csv").stat().st_mtime_ns == before


def test_impossible_families_say_so(tmp_path: Path) -> None:
    wild = BlobFamily(count=1, vertices=300, amplitude=8.0)
    with pytest.raises(Unsupported, match=r"self-intersection.*lower shapes\.amplitude"):
        generate_blobs(tmp_path, wild)
