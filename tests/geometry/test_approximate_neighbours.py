"""Approximate neighbours against the nearest ones, and graphs and trees that are made of them."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from gensp.geometry import bridges as bridging
from gensp.geometry import neighbour_pairs
from gensp.geometry import spanning_tree as trees
from gensp.geometry.approximate_neighbours import approximate_neighbours
from gensp.geometry.bridges import bridges
from gensp.geometry.neighbour_pairs import nearest_pairs
from gensp.geometry.spanning_tree import latent_neighbours, spanning_tree

MANY = 1500


def nearest(codes: np.ndarray, count: int) -> np.ndarray:
    distance = cdist(codes, codes)
    np.fill_diagonal(distance, np.inf)
    chosen = np.argpartition(distance, count - 1, axis=1)[:, :count]
    order = np.take_along_axis(distance, chosen, axis=1).argsort(axis=1)
    return np.take_along_axis(chosen, order, axis=1)


def recall(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.mean([np.isin(a, b).mean() for a, b in zip(true, found, strict=True)]))


def surface(rng: np.random.Generator, width: int) -> np.ndarray:
    """A smooth map of the cube of five dimensions."""
    slopes, phases = 2 * rng.standard_normal((5, width)), 6 * rng.random(width)
    return np.sin(rng.random((MANY, 5)) @ slopes + phases)


def crowds(rng: np.random.Generator, width: int) -> np.ndarray:
    """Thirty crowds far apart, each of few degrees of freedom."""
    middles = 3 * rng.standard_normal((30, width))
    within = 0.3 * rng.standard_normal((MANY, 8)) @ rng.standard_normal((8, width))
    return middles[rng.integers(30, size=MANY)] + within


def normal(rng: np.random.Generator, width: int) -> np.ndarray:
    """As many degrees of freedom as dimensions: the hardest."""
    return rng.standard_normal((MANY, width))


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """`MANY` codes are more than are compared with all."""
    for module in (trees, neighbour_pairs):
        monkeypatch.setattr(module, "ALL_PAIRS", MANY - 1)


Kind = Callable[[np.random.Generator, int], np.ndarray]
KINDS = [(surface, 0.97), (crowds, 0.97), (normal, 0.6)]


@pytest.mark.parametrize("width", [64, 256])
@pytest.mark.parametrize(("kind", "share"), KINDS)
def test_most_of_the_nearest_are_found(
    kind: Kind, share: float, width: int, rng: np.random.Generator
) -> None:
    codes = kind(rng, width)
    found = approximate_neighbours(codes, 16)
    assert recall(found, nearest(codes, 16)) > share
    gaps = np.linalg.norm(codes[found] - codes[:, None], axis=2)
    assert (np.diff(gaps, axis=1) >= -1e-9).all()
    assert all(len({i, *row}) == 17 for i, row in enumerate(found.tolist()))


@pytest.mark.parametrize("count", [1, 3, 16, 64])
@pytest.mark.parametrize("size", [2, 40, 64])
def test_few_codes_get_exactly_their_nearest(
    size: int, count: int, rng: np.random.Generator
) -> None:
    codes = rng.standard_normal((size, 5))
    expected = nearest(codes, min(count, size - 1))
    np.testing.assert_array_equal(approximate_neighbours(codes, count), expected)


def test_long_lists_are_full(rng: np.random.Generator) -> None:
    codes = rng.standard_normal((700, 4))
    found = approximate_neighbours(codes, 100)
    assert found.shape == (700, 100)
    assert all(len({i, *row}) == 101 for i, row in enumerate(found.tolist()))
    assert recall(found, nearest(codes, 100)) > 0.97


def test_the_same_seed_gives_the_same_neighbours(rng: np.random.Generator) -> None:
    codes = normal(rng, 64)
    first, again, other = (approximate_neighbours(codes, 8, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def twins(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Codes that lie once, in threes or by forties at one place, mixed; and their places."""
    often = np.repeat([1, 3, 40], [600, 150, 30])
    places = rng.permutation(np.repeat(np.arange(780), often))
    return rng.standard_normal((780, 64))[places], places


def test_every_twin_is_found(rng: np.random.Generator) -> None:
    codes, places = twins(rng)  # more than are compared with all
    others = np.bincount(places)[places] - 1
    found = approximate_neighbours(codes, 16)
    same = places[found] == places[:, None]
    np.testing.assert_array_equal(same.sum(axis=1), np.minimum(others, 16))
    assert (np.diff(same.astype(int), axis=1) <= 0).all()  # twins come first
    pairs = nearest_pairs(codes, 2)
    by_place = [np.flatnonzero(places == place) for place in range(600, 750)]
    assert all({(a, b), (a, c), (b, c)} <= pairs for a, b, c in by_place)


def test_zeros_of_either_sign_are_twins() -> None:
    codes = np.array([[0.0, 1], [-0.0, 1], [0.0, 2], [3, 3]])
    assert approximate_neighbours(codes, 1)[:2, 0].tolist() == [1, 0]


def test_equal_codes_have_neighbours_and_a_tree(many: None) -> None:
    codes = np.ones((MANY, 3))
    assert (approximate_neighbours(codes, 2)[-1] == [0, 1]).all()
    tree = spanning_tree(codes, root=5)
    assert sorted(tree.order) == list(range(MANY))
    np.testing.assert_array_equal(tree.weight, 0)


@pytest.mark.parametrize(("kind", "excess"), [(surface, 1e-3), (crowds, 0.01), (normal, 0.01)])
def test_the_tree_weighs_little_more_than_the_lightest(
    kind: Kind, excess: float, rng: np.random.Generator, request: pytest.FixtureRequest
) -> None:
    codes = kind(rng, 64)
    lightest = spanning_tree(codes, root=0).weight.sum()
    request.getfixturevalue("many")
    found = spanning_tree(codes, root=0)
    assert lightest * (1 - 1e-9) <= found.weight.sum() < (1 + excess) * lightest
    assert sorted(found.order) == list(range(MANY))


def test_twins_cost_a_tree_nothing(rng: np.random.Generator) -> None:
    codes, places = twins(rng)
    once = codes[np.unique(places, return_index=True)[1]]
    expected = spanning_tree(once, root=0).weight.sum()
    assert spanning_tree(codes, root=0).weight.sum() == pytest.approx(expected, rel=0.01)


def test_many_islands_are_joined_to_one_graph(rng: np.random.Generator) -> None:
    # A crowd, and islands whose nearest codes are all of their own.
    shores = np.repeat(3 * rng.standard_normal((60, 64)), 20, axis=0)
    codes = np.concatenate([rng.standard_normal((1300, 64)), shores])
    codes[1300:] += 0.01 * rng.standard_normal((1200, 64))
    near = approximate_neighbours(codes, 16)
    added = bridges(codes, near)
    assert added.shape[1] <= 60 * (bridging._PARTS + 1)
    graph = latent_neighbours(codes, root=0)
    assert trees.graph.connected_components(graph, directed=False)[0] == 1


def test_small_parts_are_joined_where_they_are_nearest(rng: np.random.Generator) -> None:
    left, right = rng.random((50, 3)), rng.random((60, 3)) + np.array([2, 0, 0])
    codes = np.concatenate([left, right])
    gap = cdist(left, right)
    i, j = np.unravel_index(gap.argmin(), gap.shape)
    found = bridges(codes, approximate_neighbours(codes, 8))
    assert found.T.tolist() == [[i, 50 + j]]
