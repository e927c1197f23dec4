"""Morphs along the tree: which nodes a way leads through, and what the generator makes there."""

from pathlib import Path

import numpy as np
import pytest
import torch

from gensp.files import save_npz, write_json
from gensp.geometry.sphere import icosphere
from gensp.stages.morphs import LatentTree, straight

# S_0 — root — left, and a sample that the model was not trained on between root and right.
CODES = {"sphere": [0.0, 0], "root": [3, 0], "left": [3, 1], "right": [5, 0]}
PARENTS = {"root": "sphere", "left": "root", "root@1": "root", "right": "root@1"}


class Shifted(torch.nn.Module):
    """g(z, p) = p + (z, 0)."""

    def forward(self, z: torch.Tensor, p: torch.Tensor) -> torch.Tensor:
        return p + torch.nn.functional.pad(z, (0, 1))[:, None]


@pytest.fixture
def tree(tmp_path: Path) -> LatentTree:
    ids = ["sphere", *PARENTS]
    parent = [-1, *(ids.index(above) for above in PARENTS.values())]
    used = [True] * len(ids)
    write_json(tmp_path / "correspond/tree.json", {"ids": ids, "parent": parent, "used": used})
    codes = np.array(list(CODES.values()), dtype=np.float32)
    save_npz(tmp_path / "finetune/latents.npz", ids=np.array(list(CODES)), codes=codes)
    return LatentTree.read(tmp_path / "correspond", tmp_path / "finetune")


def test_a_path_begins_at_the_sphere(tree: LatentTree) -> None:
    assert tree.path("left", np.zeros(2)) == ["sphere", "root", "left"]
    assert tree.path("right", np.zeros(2)) == ["sphere", "root", "root@1", "right"]


def test_what_is_no_node_hangs_from_the_nearest(tree: LatentTree) -> None:
    assert tree.path("unseen", np.array([3, 2.0])) == ["sphere", "root", "left", "unseen"]


def test_a_way_goes_through_the_codes_of_its_nodes(tree: LatentTree) -> None:
    way = tree.way(Shifted(), "left", np.array([3.0, 1]), 5, level=1)
    shifts = [mesh.vertices - icosphere(1).vertices for mesh in way.meshes]
    expected = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [3, 1, 0]]
    np.testing.assert_allclose([shift.mean(axis=0) for shift in shifts], expected, atol=1e-6)
    assert list(way.nodes) == ["root", "root", "root", "root", "left"]


def test_nodes_without_a_code_are_passed_by(tree: LatentTree) -> None:
    way = tree.way(Shifted(), "right", np.array([5.0, 0]), 6, level=0)
    assert list(way.nodes) == ["root"] * 4 + ["right"] * 2


def test_a_straight_morph_is_the_way_of_a_tree_without_nodes(tree: LatentTree) -> None:
    code = np.array([2.0, 1])
    lonely = LatentTree({"a": "sphere"}, {"sphere": np.zeros(2)})
    along = lonely.way(Shifted(), "a", code, 4, level=0).meshes
    for one, other in zip(straight(Shifted(), code, 4, level=0), along, strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-6)
