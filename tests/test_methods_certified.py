import re

import hydra
import numpy as np
import pytest

from gensp.errors import NotEmbeddable, Unsupported
from gensp.geometry.certificate import place_of
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.newton import Refined
from gensp.geometry.refine import reliability, shrinking
from gensp.geometry.sphere import icosphere, unit
from gensp.geometry.spherical_map import load_map, save_map
from gensp.methods.hierarchical import ahsp, dirichlet, stretch
from gensp.methods.refinement import (
    HIERARCHICAL,
    PREDICTION,
    UNTANGLED,
    CertifiedRefinement,
    NewtonRefinement,
)
from gensp.methods.table import PER_SHAPE, RAW, per_shape


@pytest.fixture(scope="module")
def legged():
    """A ball with five long legs, in coordinates of its own."""
    ball = icosphere(4)
    u = ball.vertices
    feet = unit(np.array([[1, 1, 0.2], [-1, 1, 0.1], [1, -1, 0], [-1, -1, -0.3], [0, 0.2, 1]]))
    bump = sum(np.exp(-(((1 - u @ foot) / 0.02) ** 2)) for foot in feet)
    return Mesh(7 + 3 * u * (1 + 3 * bump)[:, None], ball.faces, "legged")


@pytest.fixture(scope="module")
def mapped(legged):
    return dirichlet()(legged)


@pytest.mark.parametrize("name", sorted(PER_SHAPE))
def test_every_method_of_the_table_maps_a_shape_with_legs(name, legged):
    map = per_shape(name)(legged)
    assert map.certify() or name in RAW
    np.testing.assert_array_equal(map.surface, legged.vertices)
    np.testing.assert_allclose(np.linalg.norm(map.sphere, axis=1), 1, atol=1e-12)
    assert map.diagnostics["seconds"] > 0


def test_ours_is_the_least_distorted(legged, mapped):
    others = [method()(legged).distortion() for method in (stretch, ahsp)]
    assert mapped.distortion().mean < min(found.mean for found in others)
    assert mapped.distortion().max < 15


def test_map_does_not_depend_on_where_the_shape_stands(legged, mapped):
    moved = legged.with_vertices(0.01 * legged.vertices - 5)
    assert dirichlet()(moved).distortion().mean == pytest.approx(
        mapped.distortion().mean, rel=0.02
    )


def test_certificate_survives_the_file(mapped, tmp_path):
    save_map(mapped, tmp_path)
    assert load_map(tmp_path / "legged.npz").certify()


def test_clean_prediction_stays_on_the_first_rung(legged, mapped):
    found = CertifiedRefinement(crowding=0.0)(legged, mapped.sphere, mapped.sphere)
    assert found.diagnostics["rung"] == PREDICTION
    assert np.linalg.norm(found.sphere - mapped.sphere, axis=1).mean() < 0.05


def test_few_folds_are_untangled(legged, mapped):
    folded = mapped.sphere.copy()
    folded[5] = unit(folded[5] + 3 * (folded[5] - folded[legged.faces[0]].mean(axis=0)))
    start = np.where(np.arange(len(folded))[:, None] == 700, -folded, folded)
    found = CertifiedRefinement()(legged, start, start)
    assert found.diagnostics["rung"] == UNTANGLED
    assert found.certify()


def test_hopeless_prediction_is_embedded_anew(legged, rng):
    """Noise has no consistency to keep; the map is certified all the same."""
    noise = unit(rng.standard_normal(legged.vertices.shape))
    trust = np.zeros(len(noise))
    found = CertifiedRefinement()(legged, noise, noise, trust)
    assert found.diagnostics["rung"] == HIERARCHICAL
    assert found.certify()


def test_a_mirrored_start_is_embedded_anew(legged, mapped):
    """It has no fold, but degree -1: no rung that moves it can turn it round."""
    mirrored = mapped.sphere * [1, 1, -1]
    found = CertifiedRefinement()(legged, mirrored, mirrored)
    assert found.diagnostics["rung"] == HIERARCHICAL
    assert found.certify().degree == found.diagnostics["degree"] == 1
    plain = NewtonRefinement(rings=(2,))(legged, mirrored)
    assert plain.diagnostics["rung"] == HIERARCHICAL
    assert plain.certify().degree == 1


@pytest.mark.parametrize("make", [dirichlet, stretch])
def test_nothing_moves_a_certified_map_unseen(make, legged, monkeypatch):
    """What rounding could do in the last rotation or step, overdone."""
    monkeypatch.setattr(
        "gensp.methods.hierarchical.normal_rotation", lambda u, _: np.diag([1, 1, -1.0])
    )
    with pytest.raises(NotEmbeddable, match="legged: the map has degree -1"):
        make()(legged)


def test_nothing_folds_a_refined_map_unseen(legged, mapped, monkeypatch):
    def folding(mesh, start, *_, **__):
        u = start.copy()
        u[700] = -u[700]
        return Refined(u, 0.0, 1, True)

    monkeypatch.setattr("gensp.methods.refinement.refine_map", folding)
    with pytest.raises(NotEmbeddable) as caught:
        CertifiedRefinement()(legged, mapped.sphere)
    face = int(re.search(r"first: face (\d+) near", str(caught.value))[1])
    assert 700 in legged.faces[face]
    assert place_of(legged, face) in str(caught.value)


def test_only_what_was_tested_is_said_to_have_converged(legged, mapped):
    assert mapped.diagnostics["converged"] is True
    assert not {"converged", "iterations"} & stretch()(legged).diagnostics.keys()


@pytest.mark.parametrize("name", PER_SHAPE)
def test_the_table_has_the_numbers_of_the_configuration(name):
    """Also those of the flow in recipe.cmcf, and of refine=certify."""
    words = [f"method={name}", "refine=certify", "recipe=paper"]
    with hydra.initialize_config_module("conf", version_base="1.3"):
        composed = hydra.compose("config", words)
        configured = hydra.utils.instantiate(composed.method.object)()
    assert configured == per_shape(name)


def test_a_model_that_is_missing_is_asked_for():
    with pytest.raises(Unsupported, match="a trained model is required; name it with --model"):
        per_shape("gensp")


def test_folded_prediction_is_followed_where_it_holds(legged, mapped, rng):
    """A third of the sphere is scrambled; the rest decides where everything goes."""
    target = mapped.sphere[:, [1, 2, 0]]
    good = target[:, 2] < 0.3
    start = np.where(good[:, None], target, unit(target + rng.standard_normal(target.shape)))
    found = CertifiedRefinement(pull=30.0)(legged, start, start, np.where(good, 1.0, 0.0))
    assert found.certify()
    assert found.diagnostics["rung"] == HIERARCHICAL
    assert np.linalg.norm(found.sphere - target, axis=1)[good].mean() < 0.1


def test_trust_weighs_the_pull(legged, mapped):
    """Without trust the map goes where the energy sends it, with it to the target."""
    target = unit(mapped.sphere + 0.2 * np.sin(2 * mapped.sphere[:, [1, 2, 0]]))
    away = [
        np.linalg.norm(
            CertifiedRefinement(pull=30.0)(legged, target, target, np.full(len(target), t)).sphere
            - target,
            axis=1,
        ).mean()
        for t in (0.0, 0.2, 1.0)
    ]
    assert away[0] > away[1] > away[2]
    assert away[2] < 0.8 * away[0]


def test_reliability_falls_with_distance_and_folds(bumpy):
    shape, u = normalize(bumpy), unit(bumpy.vertices)
    far = np.linspace(0, 0.3, len(u))
    trusted = reliability(u, shape.faces, far, reach=0.1)
    np.testing.assert_allclose(trusted, 1 / (1 + (far / 0.1) ** 2))
    folded = u.copy()
    folded[0] = -folded[0]
    there = reliability(folded, shape.faces, np.zeros(len(u)))
    touched = np.unique(shape.faces[(shape.faces == 0).any(axis=1)])
    assert there[0] < 0.5
    assert (there[touched] < 1).any()
    assert (np.delete(there, touched) == 1).all()


def test_certified_agrees_with_newton_where_both_start_alike(legged, mapped):
    """Two ladders with one first rung and one energy end in one map, where nothing pulls."""
    start = mapped.sphere
    alike = {"energy": "sigma", "floor": 1.0, "tolerance": 1e-4, "pull": 0.0, "crowding": 0.0}
    both = [
        refinement(**alike)(legged, start, start)
        for refinement in (NewtonRefinement, CertifiedRefinement)
    ]
    np.testing.assert_allclose(both[0].sphere, both[1].sphere, atol=1e-12)


def test_limbs_are_held_as_firmly_as_the_body(legged, mapped):
    """A pull that grows with the shrinking leaves limbs less far away on the surface."""
    shape = normalize(legged)
    target = unit(mapped.sphere + 0.1 * np.sin(3 * mapped.sphere[:, [1, 2, 0]]))
    shrunk = shrinking(mapped.sphere, shape)
    limbs = shrunk > np.quantile(shrunk, 0.9)

    alike = {"energy": "sigma", "floor": 1.0, "tolerance": 3e-4, "pull": 10.0, "crowding": 0.0}

    def away(refinement):
        found = refinement(**alike)(legged, target, target)
        return np.linalg.norm(found.sphere - target, axis=1)[limbs].mean()

    assert away(CertifiedRefinement) < 0.97 * away(NewtonRefinement)


def test_what_is_left_of_the_way_to_the_target_is_made_up_for(legged, mapped, rng):
    """Bregman iterations bring back the smooth part of the way, and less of the noise."""
    wanted = unit(mapped.sphere + 0.1 * np.sin(2 * mapped.sphere[:, [1, 2, 0]]))
    target = unit(wanted + 0.01 * rng.standard_normal(wanted.shape))
    once, twice, strong = (
        CertifiedRefinement(pull=pull, bregman=rounds)(legged, target, target).sphere
        for pull, rounds in ((30.0, 0), (30.0, 1), (1e4, 0))
    )
    away = [np.linalg.norm(u - wanted, axis=1).mean() for u in (once, twice)]
    assert away[1] < 0.7 * away[0]
    rough = [roughness(legged, u - wanted) for u in (twice, strong)]
    assert rough[0] < 0.5 * rough[1]


def roughness(mesh: Mesh, field: np.ndarray) -> float:
    """Mean difference of a field between the ends of an edge."""
    return float(np.linalg.norm(np.diff(field[mesh.edges], axis=1), axis=2).mean())
