import copy

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gensp.errors import Unsupported
from gensp.geometry.guided_registration import MappedShape
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere, sample_sphere, unit
from gensp.methods.fitting import Known
from gensp.methods.guided_fitting import GuidedFit
from gensp.methods.hierarchical import dirichlet
from gensp.models import Atlas, load_model, save_model

BALL = icosphere(3)
FEET = unit(np.array([[0.0, 0.3, -1.0], [0.9, -0.2, 0.5], [-0.7, 0.6, 0.6]]))
SCHEDULE = [[30.0, 6], [3.0, 3], [0.3, 3], [0.1, 2]]
TURN = Rotation.from_rotvec([0.0, 2.2, 0.5])


def legged(*lengths: float) -> Mesh:
    squared = np.sum((BALL.vertices[:, None] - FEET) ** 2, axis=2)
    legs = (np.exp(-squared / 0.1) * np.array(lengths)) @ FEET
    return normalize(Mesh(BALL.vertices + legs, BALL.faces))


SHAPES = [legged(1.2, 0.7, 0.3), legged(1.1, 0.8, 0.3), legged(0.2, 0.9, 1.2)]
NEW = legged(1.15, 0.75, 0.3)


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    known = [MappedShape(dirichlet()(shape)) for shape in SHAPES]
    shared = {
        "sphere": BALL.vertices,
        "faces": BALL.faces,
        "images": np.stack([shape.mesh.vertices for shape in known]),
        "maps": np.stack([shape.map.sphere for shape in known]),
        "signals": np.stack([shape.signal for shape in known]).astype(np.complex64),
    }
    return Atlas.of(shared, torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 3.0]]))


def fitted(atlas: Atlas, shape: Mesh, code: list[float], **changes: int) -> np.ndarray:
    known = Known(np.array(code), lambda p: 0.1 * p, atlas)
    fit = GuidedFit(**{"neighbours": 1, "alike": 2, "guides": 2, **changes}, schedule=SCHEDULE)
    found = fit(None, shape, known)
    assert np.array_equal(found.mesh.faces, BALL.faces)
    np.testing.assert_allclose(found.sphere, BALL.vertices, atol=1e-6)
    return found.mesh.vertices


def test_a_new_shape_is_reached_from_the_nearest_code(atlas: Atlas) -> None:
    found = fitted(atlas, NEW, [0.9, 0.1], guides=0)
    assert np.linalg.norm(found - NEW.vertices, axis=1).mean() < 0.03


def test_poses_find_a_turned_shape_whatever_its_code(atlas: Atlas) -> None:
    turned = NEW.with_vertices(TURN.apply(NEW.vertices))
    led = fitted(atlas, turned, [0.0, 2.9])
    astray = fitted(atlas, turned, [0.0, 2.9], guides=0)
    assert np.linalg.norm(led - turned.vertices, axis=1).mean() < 0.04
    assert np.linalg.norm(astray - turned.vertices, axis=1).mean() > 0.2


def test_a_model_without_known_shapes_is_refused() -> None:
    with pytest.raises(Unsupported, match=r"no surface.*fit=register"):
        GuidedFit()(None, NEW, Known(np.zeros(2), lambda p: p))


def test_novelty_counts_in_gaps_between_known_codes(atlas: Atlas) -> None:
    # Nearest distances of the known codes are 1, 1 and 3; their median is 1.
    assert atlas.novelty(torch.tensor([0.0, 0.0])) == 0
    assert atlas.novelty(torch.tensor([3.0, 0.0])) == pytest.approx(2)
    one = Atlas(1, 4, 4, 2)
    assert atlas.novelty(torch.tensor([1.0, 0.5])) == pytest.approx(0.5)
    assert one.novelty(torch.tensor([1.0, 0.0])) == np.inf


def test_of_many_shapes_those_farthest_apart_are_kept(rng: np.random.Generator) -> None:
    codes = torch.tensor([[0.0], [0.1], [0.2], [5.0], [5.1], [9.0]])
    shared = {
        "sphere": BALL.vertices,
        "faces": BALL.faces,
        "images": rng.standard_normal((6, len(BALL.vertices), 3)),
        "maps": rng.standard_normal((6, len(BALL.vertices), 3)),
    }
    kept = Atlas.of(shared, codes, limit=3)
    assert kept.codes[:, 0].tolist() == pytest.approx([0.0, 5.0, 9.0], abs=0.21)
    for k, code in enumerate(kept.codes):
        place = int((codes == code).nonzero()[0, 0])
        np.testing.assert_allclose(kept.images[k].numpy(), shared["images"][place], rtol=1e-6)


def test_an_atlas_travels_with_its_model(atlas: Atlas, tmp_path) -> None:
    save_model(tmp_path / "model.pt", atlas=atlas)
    again = load_model(tmp_path / "model.pt")["atlas"]
    for name, value in atlas.state_dict().items():
        assert torch.equal(value, again.state_dict()[name])


def test_a_turn_as_placement_turns_every_point(atlas: Atlas) -> None:
    turn = Rotation.random(random_state=0).as_matrix()
    placed = copy.deepcopy(atlas)
    placed.placed.copy_(torch.from_numpy(BALL.vertices @ turn.T))
    points = sample_sphere(50, np.random.default_rng(0))
    np.testing.assert_allclose(placed.place(points), points @ turn.T, atol=1e-6)
    assert atlas.place(points) is points


def test_a_model_from_before_placements_has_its_vertices_where_they_are(atlas: Atlas) -> None:
    state = atlas.state_dict()
    del state["placed"]
    again = Atlas(**atlas.settings)
    again.load_state_dict(state)
    assert torch.equal(again.placed, atlas.sphere)
