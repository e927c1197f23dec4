"""How much memory a stage took: ranks, workers, GPUs."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from commands import train
from compare import different

from gensp.geometry.mesh import Mesh, save_mesh
from gensp.machine import own_peak_memory
from gensp.stages.memory import RankMemory, rank_memory


def test_the_largest_process_and_the_sum_of_all(tmp_path: Path) -> None:
    (tmp_path / ".memory-node1-17").write_text("900.5")
    rounds = tmp_path / "rounds" / "1"
    rounds.mkdir(parents=True)
    (rounds / ".memory-node2-17").write_text("100.25")
    found = RankMemory(largest=40.0, others=60.0, gpu=0.0).facts(tmp_path)
    assert found["peak_memory_gib"] == 900.5
    assert found["peak_memory_sum_gib"] == pytest.approx(1060.75 + own_peak_memory(), abs=0.01)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    found = RankMemory(largest=40.0, others=60.0, gpu=1.5).facts(tmp_path)
    assert found["peak_memory_gib"] == 40.0
    assert found["peak_gpu_memory_gib"] == 1.5


def test_ranks_agree_on_the_largest_process_and_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two ranks alike, on a GPU each: twice the sum, and the largest is that of either."""

    def reduce(value: torch.Tensor, reduce_op: str) -> torch.Tensor:
        return {"sum": 2 * value, "max": value}[reduce_op]

    device = torch.device("cuda", 0)
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda asked: 3 * 2**30)
    monkeypatch.setattr(torch, "tensor", lambda value, device: torch.full((), value))
    trainer = SimpleNamespace(
        world_size=2, strategy=SimpleNamespace(root_device=device, reduce=reduce)
    )
    found = rank_memory(trainer)
    assert found.gpu == 3
    assert found.others == pytest.approx(own_peak_memory(), rel=0.01)
    assert found.largest >= found.others * 0.99


@pytest.mark.slow
def test_ranks_and_their_workers_are_in_the_manifest(tmp_path: Path, bumpy: Mesh) -> None:
    """Two ranks of two workers each take more than one process, and give the same collection."""
    for number in range(4):
        save_mesh(bumpy, tmp_path / "raw" / f"m{number}.ply")
    told = {}
    for name, words in {
        "alone": ("workers.jobs=1",),
        "ranks": ("trainer=ddp_cpu", "workers.jobs=4"),
    }.items():
        places = (f"shapes.root={tmp_path / 'raw'}", f"prepare.out={tmp_path / name}")
        cache = f"paths.cache={tmp_path / 'cache' / name}"
        train("stage=prepare", "shapes=folder", "logger=none", *places, cache, *words)
        told[name] = json.loads((tmp_path / name / "manifest.json").read_text())
        assert list((tmp_path / name).glob(".memory-*")) == []
    alone, ranks = told["alone"], told["ranks"]
    assert alone["peak_memory_sum_gib"] == pytest.approx(alone["peak_memory_gib"], abs=0.05)
    assert ranks["ranks"] == 2
    # Two processes cannot have more than twice the larger: the workers are in the sum.
    assert ranks["peak_memory_sum_gib"] > 2 * ranks["peak_memory_gib"]
    assert "peak_gpu_memory_gib" not in ranks
    assert different(tmp_path / "alone", tmp_path / "ranks") == []
