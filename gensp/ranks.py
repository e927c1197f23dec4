"""Who starts the ranks of a run, and what would go wrong if Lightning did.

Lightning starts further ranks by repeating the command line. That is right for one stage of one
configuration, and wrong for whatever else a command line may do.
"""

import os
from collections.abc import Mapping
from typing import Any

from gensp.errors import Unsupported

_TORCHRUN = "torchrun --nproc-per-node N train.py"
_SLURM = "srun --nodes=M --ntasks-per-node=N python train.py trainer=slurm"


def started_outside() -> str | None:
    """Who started the ranks, one task each: torchrun, slurm, or nobody so far."""
    if "TORCHELASTIC_RUN_ID" in os.environ:
        return "torchrun"
    # Names of jobs in which a person types; Lightning ignores SLURM there, too.
    at_hand = os.environ.get("SLURM_JOB_NAME") in ("bash", "interactive")
    return "slurm" if "SLURM_NTASKS" in os.environ and not at_hand else None


def require_startable(trainer: Mapping[str, Any], *, stage: str, sweep: bool) -> None:
    """Refuse a trainer whose ranks nobody starts, or whose ranks would repeat the wrong thing.

    Parameters
    ----------
    sweep
        Whether the stage is one job of several, under `-m`.

    Raises
    ------
    Unsupported
        With the commands that do.
    """
    outside, several = started_outside(), _several(trainer)
    if not trainer.get("num_nodes", 1):
        raise Unsupported(f"trainer=slurm: no tasks of SLURM were found; start it with: {_SLURM}")
    if several and outside == "slurm" and os.environ["SLURM_NTASKS"] == "1":
        raise Unsupported(
            "trainer of several processes: one task of SLURM was found, one for each device is "
            f"required; start it with: {_SLURM}"
        )
    if outside or not several:
        return
    if int(trainer.get("num_nodes", 1)) > 1:
        raise Unsupported(
            "trainer.num_nodes: ranks on several machines must be started on each of them; start "
            f"them with: {_SLURM}; or on each: torchrun --nnodes M --nproc-per-node N "
            "--rdzv-backend c10d --rdzv-endpoint HOST:PORT train.py trainer=ddp"
        )
    if sweep:
        raise Unsupported(
            "-m: a trainer of several processes was found; each would walk through the sweep by "
            f"itself; leave -m out and run one job after the other, or start with: {_TORCHRUN} -m "
            "...; on SLURM with: hydra/launcher=submitit_slurm hydra.launcher.tasks_per_node=N "
            "trainer=slurm"
        )
    if stage == "all":
        raise Unsupported(
            "stage=all: a trainer of several processes was found; they must exist before the "
            "first stage; run one stage at a time (stage=implicit trainer=ddp), or start with: "
            f"{_TORCHRUN} ..."
        )


def _several(trainer: Mapping[str, Any]) -> bool:
    """Whether a trainer may have more than one process."""
    return str(trainer.get("devices", 1)) != "1" or trainer.get("num_nodes", 1) != 1
