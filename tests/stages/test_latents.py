import numpy as np
import pytest
import torch

from gensp.models import PointNet2Encoder
from gensp.stages import latents
from gensp.stages.latents import CloudCodes, CodeTable, draws


def table() -> CodeTable:
    codes = CodeTable(["sphere", "a", "b", "c"], 2)
    codes.update(["sphere", "a", "b", "c"], torch.tensor([[0.0, 0], [1.0, 0], [2.0, 0], [2.0, 1]]))
    return codes


def test_neighbours_are_joined_by_the_minimum_tree() -> None:
    codes = table()
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 0, 1, 2]


def test_items_never_seen_take_no_part() -> None:
    codes = CodeTable(["sphere", "a", "unseen", "c"], 1)
    codes.update(["sphere", "a", "c"], torch.tensor([[0.0], [2.0], [1.0]]))
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 3, -1, 0]
    assert codes.sample(50, draws(0, 0)).isfinite().all()


def test_given_tree_skips_ancestors_without_a_code() -> None:
    codes = table()
    codes.join({"a": "sphere", "b": "x", "x": "y", "y": "a", "c": "elsewhere"})
    assert codes.parent.tolist() == [-1, 0, 1, -1]


def test_samples_lie_on_the_edges_of_the_tree() -> None:
    codes = table()
    codes.join_neighbours()
    x, y = codes.sample(200, draws(0, 3)).T.numpy()
    on_first, on_last = np.isclose(y, 0), np.isclose(x, 2)
    assert (on_first | on_last).all()
    assert (on_first & (x < 1)).any()
    assert (on_first & (x > 1)).any()
    assert (on_last & (y > 0)).any()


def test_draws_depend_on_seed_and_step_alone() -> None:
    first = [torch.rand((), generator=draws(1, 2)).item() for _ in range(2)]
    others = [torch.rand((), generator=draws(*key)).item() for key in ((2, 2), (1, 3))]
    assert first[0] == first[1]
    assert first[0] not in others


def test_codes_of_all_ranks_are_kept_on_each() -> None:
    # Two ranks, one after the other: what one sums, the other has summed already.
    news = {"a": torch.tensor([[0.0, 0], [5, 6]]), "c": torch.tensor([[0.0, 0], [7, 8]])}
    sums: list[torch.Tensor] = []

    def collect(value: torch.Tensor) -> torch.Tensor:
        sums.append(value)
        return value

    for id, codes in news.items():
        table().update(["sphere", id], codes, collect)
    totals = iter([sums[0] + sums[2], sums[1] + sums[3]])
    codes = table()
    codes.update(["sphere", "a"], news["a"], lambda _: next(totals))
    assert codes.of(["sphere", "a", "b", "c"]).tolist() == [[0, 0], [5, 6], [2, 0], [7, 8]]


def test_stored_neighbourhoods_give_the_same_codes() -> None:
    torch.manual_seed(0)
    encoder = PointNet2Encoder(4, width=4, groups=((16, 4), (4, 4)))
    clouds, names = torch.randn(20, 40, 3), [(str(k // 2), k % 2) for k in range(20)]
    encode = CloudCodes(encoder)
    expected = encoder(clouds)
    torch.testing.assert_close(encode(names, clouds), expected)
    torch.testing.assert_close(encode(names[5:8], clouds[5:8]), expected[5:8])


def test_a_shapes_code_is_the_mean_over_its_clouds() -> None:
    torch.manual_seed(0)
    encoder = PointNet2Encoder(4, width=4, groups=((16, 4), (4, 4)))
    clouds, ids = torch.randn(10, 2, 40, 3), [str(k) for k in range(10)]
    expected = (encoder(clouds[:, 0]) + encoder(clouds[:, 1])) / 2
    found = CloudCodes(encoder).all(ids, clouds)
    torch.testing.assert_close(found, expected - expected[:1])


@pytest.fixture
def four_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latents, "ALL_PAIRS", 3)


SHAPES = ["sphere", "a", "b", "c"]
MOVED = torch.tensor([[0.0, 0], [5, 0], [9, 0], [7, 0]])  # c lies between a and b now


def test_few_items_are_joined_anew_whenever_asked() -> None:
    codes = table()
    codes.join_neighbours()
    codes.update(["sphere", "c"], MOVED[[0, 3]])
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 0, 1, 2]
    codes.update(["sphere", "b"], MOVED[[0, 2]])
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 0, 3, 1]


def test_many_items_are_joined_anew_once_all_have_been_renewed(four_are_many: None) -> None:
    codes = table()
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 0, 1, 2]
    for row in (3, 1):
        codes.update(["sphere", SHAPES[row]], MOVED[[0, row]])
        codes.join_neighbours()
        assert codes.parent.tolist() == [-1, 0, 1, 2]
    codes.update(["sphere", "b"], MOVED[[0, 2]])
    codes.join_neighbours()
    assert codes.parent.tolist() == [-1, 0, 3, 1]


def test_ranks_count_what_is_renewed_as_one_process_does(four_are_many: None) -> None:
    one, several = table(), table()
    for codes in (one, several):
        codes.join_neighbours()
    one.update(SHAPES, MOVED)
    # Both ranks have S_0; the other has a.
    other = torch.zeros(4, 2), torch.tensor([[1.0], [1], [0], [0]])
    other[0][1] = MOVED[1]
    others = iter(other)
    several.update(["sphere", "b", "c"], MOVED[[0, 2, 3]], lambda mine: mine + next(others))
    assert one.renewed == several.renewed == 3
    for codes in (one, several):
        codes.join_neighbours()
        assert codes.parent.tolist() == [-1, 0, 3, 1]
        assert codes.renewed == 0
