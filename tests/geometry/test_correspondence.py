from itertools import combinations, product

import numpy as np
import pytest

from gensp.errors import Unsupported
from gensp.geometry.correspondence import carry, closest_agreeing, correspondence, propagate
from gensp.geometry.distance import closest_point
from gensp.geometry.mesh import Mesh
from gensp.geometry.points import SurfacePoints, sample_surface
from gensp.geometry.spanning_tree import Tree, along_path, ancestors, spanning_tree
from gensp.geometry.sphere import icosphere


def vertices_as_points(mesh: Mesh) -> SurfacePoints:
    return closest_point(mesh.vertices, mesh).at


def is_tree(parent: tuple[int, ...], root: int) -> bool:
    for node in range(len(parent)):
        for _ in parent:
            node = parent[node] if node != root else root
        if node != root:
            return False
    return True


def rooted_trees(count: int, root: int) -> list[tuple[int, ...]]:
    choices = [[root] if k == root else list(range(count)) for k in range(count)]
    return [parent for parent in product(*choices) if is_tree(parent, root)]


def test_the_minimum_tree_is_the_lightest_of_all_trees(rng: np.random.Generator) -> None:
    codes = rng.standard_normal((6, 3))
    distance = np.linalg.norm(codes[:, None] - codes, axis=2)
    tree = spanning_tree(codes, root=2)
    weights = [distance[np.arange(6), parent].sum() for parent in rooted_trees(6, 2)]
    assert tree.weight.sum() == pytest.approx(min(weights))
    assert tree.parent[2] == -1


def test_shortest_paths_are_the_shortest_of_all_paths(rng: np.random.Generator) -> None:
    codes = rng.standard_normal((6, 2))
    squared = np.square(codes[:, None] - codes).sum(axis=2)
    tree = spanning_tree(codes, root=0, kind="shortest")
    candidates = np.array(
        [[_cost(parent, node, squared) for node in range(6)] for parent in rooted_trees(6, 0)]
    )
    found = [_cost(tuple(tree.parent), node, squared) for node in range(6)]
    np.testing.assert_allclose(found, candidates.min(axis=0), atol=1e-9)


def _cost(parent: tuple[int, ...], node: int, squared: np.ndarray) -> float:
    total = 0.0
    while node != 0:
        total, node = total + squared[node, parent[node]], parent[node]
    return total


@pytest.mark.parametrize("kind", ["minimum", "shortest", "star"])
def test_trees_are_ordered_parents_first(kind: str, rng: np.random.Generator) -> None:
    codes = rng.standard_normal((40, 4))
    tree = spanning_tree(codes, root=7, kind=kind)
    place = np.argsort(tree.order)
    others = np.arange(40) != 7
    assert tree.order[0] == 7
    assert sorted(tree.order) == list(range(40))
    assert (place[tree.parent[others]] < place[others]).all()
    expected = np.linalg.norm(codes[others] - codes[tree.parent[others]], axis=1)
    np.testing.assert_allclose(tree.weight[others], expected)
    assert tree.depth()[7] == 0
    assert len(tree.path(3)) == tree.depth()[3] + 1
    assert tree.path(3)[0] == 7


def test_a_star_has_depth_one(rng: np.random.Generator) -> None:
    tree = spanning_tree(rng.standard_normal((9, 2)), root=4, kind="star")
    assert (np.delete(tree.parent, 4) == 4).all()


def test_shapes_of_equal_codes_stay_connected() -> None:
    codes = np.array([[0.0], [1.0], [1.0], [1.0], [2.0]])
    for kind in ("minimum", "shortest"):
        tree = spanning_tree(codes, root=0, kind=kind)
        assert sorted(tree.order) == [0, 1, 2, 3, 4]
        assert tree.weight.sum() >= 2


def test_an_unknown_tree_is_refused() -> None:
    with pytest.raises(Unsupported, match=r"'widest' is unknown; minimum, shortest or star"):
        spanning_tree(np.eye(3), root=0, kind="widest")


def test_only_ancestors_of_inputs_are_used() -> None:
    parent = np.array([-1, 0, 1, 1, 0, 4, 2])
    tree = Tree(parent, np.array([0, 1, 4, 2, 3, 5, 6]), np.ones(7))
    assert np.flatnonzero(ancestors(tree, [2])).tolist() == [0, 1, 2]
    assert np.flatnonzero(ancestors(tree, [6, 4])).tolist() == [0, 1, 2, 4, 6]


def test_an_identity_edge_keeps_points(bumpy: Mesh, rng: np.random.Generator) -> None:
    points = sample_surface(bumpy.face_areas, 200, rng)
    carried = carry(points, bumpy.faces, bumpy.vertices, bumpy)
    here, there = (p.on(bumpy.vertices, bumpy.faces) for p in (points, carried))
    np.testing.assert_allclose(there, here, atol=1e-12)


def test_carrying_over_another_triangulation_keeps_positions(
    ellipsoid: Mesh, rng: np.random.Generator
) -> None:
    # The child is the same polyhedron with every face split: the edge is known exactly.
    a, b, c = ellipsoid.faces.T
    centre = len(ellipsoid.vertices) + np.arange(len(a))
    faces = np.concatenate(
        [np.stack(corners, 1) for corners in ((a, b, centre), (b, c, centre), (c, a, centre))]
    )
    middles = ellipsoid.vertices[ellipsoid.faces].mean(axis=1)
    child = Mesh(np.concatenate([ellipsoid.vertices, middles]), faces, "child")
    points = sample_surface(ellipsoid.face_areas, 100, rng)
    there = carry(points, ellipsoid.faces, ellipsoid.vertices, child)
    np.testing.assert_allclose(
        there.on(child.vertices, child.faces),
        points.on(ellipsoid.vertices, ellipsoid.faces),
        atol=1e-12,
    )


def test_two_edges_are_the_stitched_one(bumpy: Mesh) -> None:
    # Every edge is an affine map of the same connectivity: carrying commutes with the map.
    first, second = np.diag([1.3, 0.8, 1.1]), np.array([[1, 0.2, 0], [0, 1, 0.1], [0, 0, 1.0]])
    middle = bumpy.with_vertices(bumpy.vertices @ first)
    end = bumpy.with_vertices(middle.vertices @ second)
    meshes = {0: bumpy, 1: middle, 2: end}
    registered = {1: middle.vertices, 2: end.vertices}
    tree = Tree(np.array([-1, 0, 1]), np.arange(3), np.array([0.0, 1, 1]))
    carried = dict(
        propagate(
            tree,
            np.ones(3, dtype=bool),
            mesh=meshes.__getitem__,
            registered=registered.__getitem__,
            sphere=bumpy,
        )
    )
    np.testing.assert_allclose(carried[2].points, end.vertices, atol=1e-9)
    direct = carry(vertices_as_points(bumpy), bumpy.faces, end.vertices, end)
    np.testing.assert_allclose(carried[2].points, direct.on(end.vertices, end.faces), atol=1e-9)
    assert all(one.valid.all() and one.fold_rate == 0 for one in carried.values())


def test_unwanted_branches_are_not_read(bumpy: Mesh) -> None:
    tree = Tree(np.array([-1, 0, 0]), np.arange(3), np.zeros(3))
    carried = dict(
        propagate(
            tree,
            np.array([True, True, False]),
            mesh={0: bumpy, 1: bumpy}.__getitem__,
            registered={1: bumpy.vertices}.__getitem__,
            sphere=icosphere(2),
        )
    )
    assert sorted(carried) == [0, 1]


def test_folded_and_collapsed_triangles_are_masked() -> None:
    ball = icosphere(3)
    clean = correspondence(vertices_as_points(ball), ball, ball.faces)
    assert clean.valid.all()
    assert clean.fold_rate == 0
    moved = ball.vertices.copy()
    neighbours = np.unique(ball.faces[(ball.faces == 100).any(axis=1)])
    # One vertex dragged over its ring turns some of its faces around.
    moved[100] = ball.vertices[neighbours[neighbours != 100][0]] * 2 - ball.vertices[100]
    folded = correspondence(closest_point(moved, ball).at, ball, ball.faces)
    assert not folded.valid[100]
    assert folded.fold_rate > 0
    assert folded.valid[np.linalg.norm(ball.vertices - ball.vertices[100], axis=1) > 0.6].all()
    moved[100] = ball.vertices[neighbours[neighbours != 100][0]]
    collapsed = correspondence(closest_point(moved, ball).at, ball, ball.faces)
    assert collapsed.fold_rate == pytest.approx(2 / len(ball.faces))


def test_a_thin_limb_is_not_crossed() -> None:
    # A flat pancake, 0.02 thick: points a little inside it are nearer to the far side.
    ball = icosphere(4)
    pancake = Mesh(ball.vertices * np.array([1, 1, 0.01]), ball.faces, "pancake")
    inside = (np.abs(ball.vertices[:, 2]) > 0.5) & (ball.vertices[:, 2] > 0)
    upper = pancake.vertices[inside] * np.array([1, 1, -0.2])
    up = np.tile([0.0, 0, 1], (len(upper), 1))
    plain = closest_point(upper, pancake).at.on(pancake.vertices, pancake.faces)
    aware = closest_agreeing(upper, up, pancake).on(pancake.vertices, pancake.faces)
    assert (plain[:, 2] < 0).all()
    assert (aware[:, 2] > 0).mean() > 0.95


def test_a_fold_is_not_thrown_across_the_shape() -> None:
    # Reversed normals on a thick shape: no agreeing face is near, the closest point is kept.
    ball = icosphere(3)
    points = 1.01 * ball.vertices
    carried = closest_agreeing(points, -ball.vertices, ball)
    gap = np.linalg.norm(carried.on(ball.vertices, ball.faces) - points, axis=1)
    assert gap.max() < 0.05


def test_rigid_motion_of_everything_changes_nothing(
    bumpy: Mesh, ellipsoid: Mesh, rng: np.random.Generator
) -> None:
    rotation = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    points = sample_surface(bumpy.face_areas, 300, rng)
    start = carry(points, bumpy.faces, ellipsoid.vertices, ellipsoid)
    moved = ellipsoid.with_vertices(ellipsoid.vertices @ rotation.T + 1)
    again = carry(points, bumpy.faces, moved.vertices, moved)
    np.testing.assert_allclose(
        again.on(moved.vertices, moved.faces),
        start.on(ellipsoid.vertices, ellipsoid.faces) @ rotation.T + 1,
        atol=1e-9,
    )


def test_brute_force_helper_counts_cayleys_trees() -> None:
    assert len(rooted_trees(4, 0)) == 4**2
    assert len(list(combinations(range(4), 2))) == 6


def test_a_path_is_walked_in_equal_steps() -> None:
    corner = np.array([[0.0, 0], [3, 0], [3, 1]])
    points, ends = along_path(corner, 5)
    np.testing.assert_allclose(points, [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1]])
    assert ends.tolist() == [1, 1, 1, 1, 2]


def test_a_path_that_rests_is_walked_as_one_that_does_not() -> None:
    corner = np.array([[0.0, 0], [3, 0], [3, 0], [3, 1]])
    points, ends = along_path(corner, 5)
    np.testing.assert_allclose(points, along_path(corner[[0, 1, 3]], 5)[0])
    assert ends[-1] == 3
    alone, end = along_path(corner[:1], 2)
    np.testing.assert_array_equal(alone, corner[[0, 0]])
    assert end.tolist() == [0, 0]
