"""Who starts the ranks of a run, and what would go wrong if Lightning did.

Lightning starts further ranks by repeating the command line. That is right for one stage of one
configuration, and wrong for whatever else a command line may do.
"""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from gensp.errors import Unsupported

_TORCHRUN = "torchrun --nproc-per-node N train.py"
_SLURM = "srun --kill-on-bad-exit=1 --nodes=M --ntasks-per-node=N python train.py trainer=slurm"


def started_outside() -> str | None:
    """Who started the ranks, one task each: torchrun, slurm, or nobody so far."""
    if "TORCHELASTIC_RUN_ID" in os.environ:
        return "torchrun"
    # Names of jobs in which a person types; Lightning ignores SLURM there, too.
    at_hand = os.environ.get("SLURM_JOB_NAME") in ("bash", "interactive")
    return "slurm" if "SLURM_NTASKS" in os.environ and not at_hand else None


def of_several(trainer: Mapping[str, Any]) -> bool:
    """Whether this process is, or may be, one of several ranks."""
    return started_outside() is not None or _processes(trainer) != 1


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
    _require_device(str(trainer.get("accelerator", "auto")))
    outside, several = started_outside(), _processes(trainer) != 1
    if not trainer.get("num_nodes", 1):
        raise Unsupported(f"trainer=slurm: no tasks of SLURM were found; start it with: {_SLURM}")
    if several and outside == "slurm" and os.environ["SLURM_NTASKS"] == "1":
        raise Unsupported(
            "trainer of several processes: one task of SLURM was found, one for each device is "
            f"required; start it with: {_SLURM}"
        )
    _require_agreement(trainer, _world(outside, several=several))
    if outside or not several:
        return
    if int(trainer.get("num_nodes", 1)) > 1:
        raise Unsupported(
            "trainer.num_nodes: ranks on several machines must be started on each of them; start "
            f"them with: {_SLURM}; or on each: torchrun --nnodes M --nproc-per-node N "
            "--rdzv-backend c10d --rdzv-endpoint HOST:PORT train.py trainer=ddp "
            "trainer.num_nodes=M"
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


def _require_device(accelerator: str) -> None:
    """Refuse a GPU where there is none; torch is loaded only where one is asked for."""
    if accelerator not in {"gpu", "cuda"}:
        return
    import torch

    if not (torch.cuda.is_available() or torch.backends.mps.is_available()):
        raise Unsupported(
            f"trainer.accelerator: is {accelerator}; no GPU that torch can use was found; one is "
            "required; type trainer=cpu, or install a torch for your GPU"
        )


def _processes(trainer: Mapping[str, Any]) -> int | None:
    """How many processes a trainer has; None where the machine decides, as with devices=auto."""
    devices, nodes = trainer.get("devices", 1), int(trainer.get("num_nodes", 1))
    if isinstance(devices, str) and "," in devices:
        devices = [word for word in devices.split(",") if word.strip()]
    if isinstance(devices, Sequence) and not isinstance(devices, str):
        return len(devices) * nodes
    # Also where it is none of Lightning's words: that is told by Lightning.
    return int(devices) * nodes if str(devices).isdigit() else None


def _world(outside: str | None, *, several: bool) -> int:
    """How many processes were started together, this one among them."""
    if outside == "torchrun":
        return int(os.environ.get("WORLD_SIZE", "1"))
    # What srun sets for its step alone. A job's own script is one process of a job of many tasks.
    step = int(os.environ.get("SLURM_STEP_NUM_TASKS", "1"))
    if outside == "slurm":
        return int(os.environ["SLURM_NTASKS"]) if several and step == 1 else step
    # A shell that srun opened is one process, whatever its step has.
    return 1 if "SLURM_PTY_PORT" in os.environ else step


def _require_agreement(trainer: Mapping[str, Any], world: int) -> None:
    """Refuse processes started together of which the trainer knows nothing: each would be alone.

    With devices=auto only torch knows how many there are, and a strategy of ranks looks by itself.
    """
    asked = _processes(trainer)
    if asked is None and trainer.get("strategy", "auto") == "auto" and world > 1:
        found = "a trainer that may be a single process (trainer.strategy=auto)"
    elif asked is not None and world != asked and (world > 1 or started_outside() is not None):
        found = f"a trainer of {asked} (trainer.devices and trainer.num_nodes)"
    else:
        return
    raise Unsupported(
        f"ranks: {world} processes were started together, and {found} was found; their numbers "
        "must agree, or each would do the same work in one folder; start one process, or as many "
        f"as the trainer has with: {_TORCHRUN} trainer=ddp; on SLURM with: {_SLURM}"
    )
