"""How much memory a stage took, over all ranks, their workers and GPUs."""

from dataclasses import dataclass
from pathlib import Path

import torch
from lightning import Trainer
from torch import Tensor

from gensp.machine import forget_peak_memory, noted_peak_memories, own_peak_memory, peak_memory


@dataclass(frozen=True)
class RankMemory:
    """Peaks in GiB: of the largest process of any rank, of the other ranks' sum, of any GPU."""

    largest: float
    others: float
    gpu: float

    def facts(self, folder: Path) -> dict[str, float]:
        """What the manifest keeps, at the very end; takes up what workers left in the folder.

        peak_memory_gib is the largest resident size of one process: a rank, a child of it that
        still runs, or a worker that did items. peak_memory_sum_gib adds the peaks of all ranks and
        of all these workers, which need not have been at one time: more was never needed by them.
        peak_gpu_memory_gib is what torch had allocated on one GPU, where there is one.
        """
        workers, own = noted_peak_memories(folder), own_peak_memory()
        found = {
            "peak_memory_gib": round(max(self.largest, peak_memory(), *workers), 3),
            "peak_memory_sum_gib": round(self.others + own + sum(workers), 3),
        }
        return found | ({"peak_gpu_memory_gib": round(self.gpu, 3)} if self.gpu else {})


def forget_memory() -> None:
    """Let all peaks tell of what comes after; a GPU that was not used has none."""
    forget_peak_memory()
    if torch.cuda.is_initialized():
        for device in range(torch.cuda.device_count()):
            torch.cuda.reset_peak_memory_stats(device)


def rank_memory(trainer: Trainer) -> RankMemory:
    """What all ranks took so far; all of them must ask, and all get the same but for `others`."""
    device, own = trainer.strategy.root_device, own_peak_memory()
    gpu = torch.cuda.max_memory_allocated(device) / 2**30 if device.type == "cuda" else 0.0
    largest, most_gpu = (_over_ranks(trainer, value, "max") for value in (peak_memory(), gpu))
    return RankMemory(largest, _over_ranks(trainer, own, "sum") - own, most_gpu)


def _over_ranks(trainer: Trainer, value: float, how: str) -> float:
    if trainer.world_size == 1:
        return value
    told: Tensor | float = trainer.strategy.reduce(
        torch.tensor(value, device=trainer.strategy.root_device), reduce_op=how
    )
    return float(told)
