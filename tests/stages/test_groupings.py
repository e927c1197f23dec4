"""Neighbourhoods kept on disk come back as they were."""

from pathlib import Path

import pytest
import torch

from gensp.errors import OutputError
from gensp.models import PointNet2Encoder
from gensp.stages.groupings import Groupings

GROUPS = ((16, 4), (4, 3))


def test_groupings_come_back_by_name(tmp_path: Path) -> None:
    torch.manual_seed(0)
    encoder = PointNet2Encoder(4, width=4, groups=GROUPS)
    clouds = torch.randn(6, 40, 3)
    kept = Groupings(GROUPS, tmp_path / "new")
    for k, cloud in enumerate(clouds):
        assert (str(k), 0) not in kept
        kept.keep((str(k), 0), encoder.group(cloud[None]))
    for k in (5, 0, 3):
        expected, found = encoder.group(clouds[k][None]), kept.of((str(k), 0))
        for one, other in zip(expected.centres, found.centres, strict=True):
            assert torch.equal(one, other)
        for one, other in zip(expected.neighbours, found.neighbours, strict=True):
            assert torch.equal(one, other)
    assert list((tmp_path / "new").iterdir()) == []


def test_no_room_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    encoder = PointNet2Encoder(4, width=4, groups=GROUPS)
    kept = Groupings(GROUPS, tmp_path / "file")
    with pytest.raises(OutputError, match=r"file: cannot be written .*384 bytes each"):
        kept.keep(("a", 0), encoder.group(torch.randn(1, 40, 3)))
