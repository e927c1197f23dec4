"""Neighbours in place of all pairs: the same where both can be had, and no large matrix."""

import numpy as np
import pytest

from gensp.geometry import neighbour_pairs, registration_graph
from gensp.geometry import spanning_tree as trees
from gensp.geometry.neighbour_pairs import (
    agreeing_pairs,
    degree_norms,
    nearest_pairs,
    rotation_candidates,
)
from gensp.geometry.registration_graph import least_strained_tree
from gensp.geometry.rotation_registration import density_signal, register_rotation
from gensp.geometry.spanning_tree import latent_neighbours, spanning_tree
from gensp.geometry.sphere import icosphere


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the size, there are too many pairs."""
    for module in (trees, neighbour_pairs, registration_graph):
        monkeypatch.setattr(module, "ALL_PAIRS", 2)


@pytest.fixture
def codes(rng: np.random.Generator) -> np.ndarray:
    """Two crowds of codes on a plane in eight dimensions, the root far from both."""
    flat = rng.standard_normal((300, 2)) + np.repeat([[0, 0], [30, 0]], 150, axis=0)
    flat[0] = [0, 40]
    return flat @ rng.standard_normal((2, 8))


def test_nearest_pairs_are_those_of_all_pairs(
    codes: np.ndarray, request: pytest.FixtureRequest
) -> None:
    whole = nearest_pairs(codes, 4)
    request.getfixturevalue("few")
    assert nearest_pairs(codes, 4) == whole


def test_twins_are_not_their_own_neighbours(few: None) -> None:
    codes = np.repeat(np.arange(3.0)[:, None], 5, axis=0)
    assert all(i < j for i, j in nearest_pairs(codes, 3))


def test_the_minimum_tree_is_that_of_all_pairs_within_crowds(
    codes: np.ndarray, request: pytest.FixtureRequest
) -> None:
    whole = spanning_tree(codes, root=0)
    request.getfixturevalue("few")
    found = spanning_tree(codes, root=0)
    assert sorted(found.order) == list(range(300))
    assert found.order[0] == 0
    edges = [{frozenset(e) for e in enumerate(tree.parent)} for tree in (whole, found)]
    assert len(edges[0] & edges[1]) >= 297  # all but what joins the crowds and the root
    assert found.weight.sum() <= 1.5 * whole.weight.sum()


def test_shortest_ways_are_nearly_those_of_all_pairs(
    codes: np.ndarray, request: pytest.FixtureRequest
) -> None:
    def ways(parent: np.ndarray, order: np.ndarray) -> np.ndarray:
        length = np.zeros(len(codes))
        for node in order[1:]:
            step = np.square(codes[node] - codes[parent[node]]).sum()
            length[node] = length[parent[node]] + step
        return length

    whole = spanning_tree(codes, root=0, kind="shortest")
    request.getfixturevalue("few")
    found = spanning_tree(codes, root=0, kind="shortest")
    assert ways(found.parent, found.order).sum() < 1.2 * ways(whole.parent, whole.order).sum()


def test_the_neighbour_graph_is_connected_and_small(codes: np.ndarray) -> None:
    found = latent_neighbours(codes, 0, count=3)
    assert found.nnz <= 3 * len(codes) + 2
    i, j = found.nonzero()
    gap = np.linalg.norm(codes[i] - codes[j], axis=1)
    np.testing.assert_allclose(np.asarray(found[i, j]).ravel(), gap)
    parts = trees.graph.connected_components(found, directed=False)[0]
    assert parts == 1


def test_the_least_strained_tree_has_the_same_edges_from_landmarks(
    rng: np.random.Generator, request: pytest.FixtureRequest
) -> None:
    strains = {(k, k + 1): float(rng.random()) for k in range(9)} | {(2, 7): 0.1}
    whole = least_strained_tree(10, strains)
    request.getfixturevalue("few")
    found = least_strained_tree(10, strains)
    np.testing.assert_array_equal(found.parent, whole.parent)


@pytest.fixture(scope="module")
def signals() -> list[np.ndarray]:
    ball, rng = icosphere(3), np.random.default_rng(0)
    areas = [np.exp(ball.vertices[ball.faces].mean(axis=1) @ rng.normal(size=3)) for _ in range(6)]
    return [density_signal(ball.vertices, ball.faces, area, bandlimit=8) for area in areas]


def test_no_rotation_agrees_more_than_the_norms_by_degree(signals: list[np.ndarray]) -> None:
    bound = degree_norms(signals) @ degree_norms(signals).T
    for i in range(6):
        for j in range(i):
            found = register_rotation(signals[i], signals[j], candidates=1)[0].correlation
            assert found <= bound[i, j] + 1e-9


def test_likely_pairs_hold_the_best(
    signals: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = agreeing_pairs(signals, 1)
    assert len(rotation_candidates(signals)) == 15
    monkeypatch.setattr(neighbour_pairs, "ALL_AGREEMENTS", 2)
    monkeypatch.setattr(neighbour_pairs, "CANDIDATES", 3)
    assert len(rotation_candidates(signals)) < 15
    assert agreeing_pairs(signals, 1) == whole
