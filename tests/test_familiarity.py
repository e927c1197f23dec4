from pathlib import Path

import numpy as np
import pytest
import torch

import gensp
from gensp.data.shapes import ShapeCollection
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.methods.familiarity import beyond, signals
from gensp.methods.fitting import SurfaceOnSphere
from gensp.methods.gensp import GenSP
from gensp.models import Atlas

DATA = Path(__file__).parents[1] / "data"
BALL = icosphere(3)
EGG = Mesh(BALL.vertices * np.array([1.0, 1.3, 0.9]) + 0.1 * BALL.vertices**2, BALL.faces)


def atlas_of(*codes: float) -> Atlas:
    images = np.stack([(1 + k) * BALL.vertices for k in range(len(codes))])
    shared = {"sphere": BALL.vertices, "faces": BALL.faces, "images": images, "maps": images}
    return Atlas.of(shared, torch.tensor(codes)[:, None])


@pytest.mark.parametrize("scale", [1.0, 5.0])
def test_the_gap_is_the_distance_that_is_left_over_the_root_of_the_area(scale: float) -> None:
    around, ball = (Mesh(r * scale * BALL.vertices, BALL.faces) for r in (1.1, 1.0))
    fitted = SurfaceOnSphere(around, BALL.vertices)
    found = signals(atlas_of(0, 1), np.array([3.0], np.float32), fitted, ball)
    # The nearest point of a convex surface to a vertex moved outward is where it came from.
    assert found["gap"] == pytest.approx(0.1 * scale / np.sqrt(ball.area))
    assert found["novelty"] == pytest.approx(2)
    assert found["stretch"] == pytest.approx(0, abs=1e-6)


def sheet(count: int) -> Mesh:
    """The unit square as triangles."""
    corner = np.arange(count * (count + 1)).reshape(count, count + 1)[:, :-1].reshape(-1)
    other = corner + count + 2
    faces = np.concatenate(
        [np.stack([corner, corner + 1, other], 1), np.stack([corner, other, other - 1], 1)]
    )
    x, y = np.meshgrid(*2 * [np.linspace(0, 1, count + 1)])
    return Mesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1), faces)


def test_a_bent_shape_is_not_stretched_and_the_most_alike_counts() -> None:
    flat = sheet(20)
    images = np.stack([flat.vertices, flat.vertices * [3.0, 1.0, 1.0]])
    shared = {"sphere": images[0], "faces": flat.faces, "images": images, "maps": images}
    atlas = Atlas.of(shared, torch.zeros((2, 1)))
    x, y, _ = flat.vertices.T
    rolled = np.stack([np.cos(x), np.sin(x), y], axis=1)
    assert atlas.stretch(7 * rolled) == pytest.approx(0, abs=1e-3)
    # At equal areas σ is 2 from the first and 2/√3 from the second, everywhere.
    found = atlas.stretch(flat.vertices * [2.0, 0.5, 1.0])
    assert found == pytest.approx(1 - np.sqrt(3) / 2, abs=1e-5)


def test_what_is_beyond_a_limit_is_told_with_it() -> None:
    limits = {"gap": 0.001, "stretch": 0.3}
    assert beyond({"gap": 0.001, "stretch": 0.3}, limits) == ""
    assert beyond({"gap": 0.0025, "stretch": 0.1}, limits) == "gap 0.250% above 0.100%"
    assert beyond({"gap": 0.0, "stretch": 0.5}, limits) == "stretch 0.50 above 0.30"
    assert beyond({"gap": 0.1, "stretch": 0.5}, limits).count(" and ") == 1


def test_an_atlas_without_some_of_its_shapes_knows_the_others() -> None:
    whole = atlas_of(0, 1, 5)
    fewer = whole.without([1])
    assert fewer.codes[:, 0].tolist() == [0, 5]
    assert torch.equal(fewer.images, whole.images[[0, 2]])
    assert torch.equal(fewer.sphere, whole.sphere)
    # Known codes are 5 apart; the nearest to 1 is 0.
    assert fewer.novelty(torch.tensor([1.0])) == pytest.approx(0.2)
    assert len(whole.codes) == 3


@pytest.fixture(scope="module")
def models() -> dict[str, GenSP]:
    return {name: gensp.load(name) for name in ("heads", "quadrupeds")}


def far(method: GenSP, mesh: Mesh) -> str:
    """What a map says at its end; both signals are there before the map is made."""
    shape = normalize(mesh)
    code = method.encode(shape)
    return method.familiarity(shape, code, method.fitted(shape, code, method.generate(code)))[
        "far"
    ]


def of_collection(name: str, id: str) -> Mesh:
    return ShapeCollection.from_folder(DATA / name).mesh(id)


@pytest.mark.parametrize(
    ("name", "id"), [("heads", "id012_neutral"), ("quadrupeds", "donkey_death")]
)
def test_shapes_never_seen_of_a_known_kind_are_near(models, name: str, id: str) -> None:
    assert far(models[name], of_collection(name, id)) == ""


@pytest.mark.parametrize(
    ("name", "other", "id"),
    [("heads", "quadrupeds", "husky_rest"), ("quadrupeds", "heads", "id000_neutral")],
)
def test_shapes_of_another_kind_are_far(models, name: str, other: str, id: str) -> None:
    assert "gap" in far(models[name], of_collection(other, id))


def test_an_egg_is_far(models) -> None:
    assert "gap" in far(models["heads"], EGG)
