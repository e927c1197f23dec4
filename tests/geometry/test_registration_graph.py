import numpy as np

from gensp.geometry.registration_graph import least_strained_tree, reached_nodes


def test_the_tree_hangs_from_the_middle_of_a_chain() -> None:
    chain = {(0, 1): 1.0, (1, 2): 1.0, (2, 3): 1.0, (3, 4): 1.0}
    tree = least_strained_tree(5, chain)
    assert tree.order[0] == 2
    assert tree.parent.tolist() == [1, 2, -1, 2, 3]
    np.testing.assert_allclose(tree.weight, [1, 1, 0, 1, 1])


def test_a_detour_of_less_strain_is_taken() -> None:
    tree = least_strained_tree(3, {(0, 1): 0.2, (1, 2): 0.2, (0, 2): 0.9})
    assert tree.order[0] == 1
    assert tree.parent.tolist() == [1, -1, 1]
    straight = least_strained_tree(3, {(0, 1): 0.2, (1, 2): 0.2, (0, 2): 0.1})
    np.testing.assert_allclose(straight.weight.sum(), 0.3)


def test_nodes_without_an_edge_are_not_reached() -> None:
    tree = least_strained_tree(5, {(1, 2): 0.3, (2, 4): 0.0})
    assert sorted(reached_nodes(tree)) == [1, 2, 4]
    assert reached_nodes(tree)[0] == 2
    assert tree.parent[0] == tree.parent[3] == -1


def test_one_shape_is_its_own_tree() -> None:
    tree = least_strained_tree(1, {})
    assert list(reached_nodes(tree)) == [0]


def test_the_order_of_the_nodes_plays_no_part(rng: np.random.Generator) -> None:
    strains = {(i, j): float(rng.uniform(0.1, 1)) for i in range(7) for j in range(i)}
    tree = least_strained_tree(7, strains)
    place = rng.permutation(7)
    moved = least_strained_tree(
        7, {(int(place[i]), int(place[j])): s for (i, j), s in strains.items()}
    )
    assert moved.order[0] == place[tree.order[0]]
    for node in range(7):
        parent = tree.parent[node]
        assert moved.parent[place[node]] == (-1 if parent < 0 else place[parent])
