"""Who may start the ranks of a run, and jobs that Hydra submits."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from commands import free_port, run_here, smoke_words, train
from hydra.errors import MissingConfigException

from gensp.compute import Row
from gensp.data.modules import ItemsModule
from gensp.errors import Unsupported
from gensp.mistakes import hydra_line
from gensp.ranks import require_startable, started_outside
from gensp.sharing import Workers

OUTSIDE = (
    *("TORCHELASTIC_RUN_ID", "WORLD_SIZE", "SLURM_NTASKS", "SLURM_JOB_NAME"),
    *("SLURM_NTASKS_PER_NODE", "SLURM_STEP_NUM_TASKS", "SLURM_PTY_PORT"),
)
ONE = {"strategy": "auto", "devices": 1, "num_nodes": 1}
DDP = {"strategy": {"_target_": "gensp.stages.session.ddp"}, "devices": "auto", "num_nodes": 1}


@pytest.fixture(autouse=True)
def _nobody_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in OUTSIDE:
        monkeypatch.delenv(name, raising=False)


def test_what_lightning_can_start_is_started() -> None:
    assert started_outside() is None
    require_startable(ONE, stage="all", sweep=True)
    require_startable(DDP, stage="implicit", sweep=False)


@pytest.mark.parametrize(
    ("trainer", "stage", "sweep", "line"),
    [
        (DDP, "all", False, "stage=all: .* one stage at a time .* torchrun"),
        (ONE | {"devices": 2}, "all", False, "stage=all: .* torchrun"),
        (DDP, "implicit", True, "-m: .* leave -m out .* torchrun .*=submitit_slurm"),
        (DDP | {"num_nodes": 2}, "implicit", False, "trainer.num_nodes: .* srun .* --rdzv"),
        (DDP | {"num_nodes": 0}, "implicit", False, "trainer=slurm: no tasks of SLURM .* srun"),
    ],
)
def test_what_lightning_cannot_start_is_refused(
    trainer: dict[str, object], stage: str, sweep: bool, line: str
) -> None:
    with pytest.raises(Unsupported, match=line):
        require_startable(trainer, stage=stage, sweep=sweep)


@pytest.mark.parametrize("stage", ["all", "implicit"])
@pytest.mark.parametrize("sweep", [False, True])
def test_as_many_ranks_from_outside_as_the_trainer_has_may_do_anything(
    stage: str, sweep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLURM_NTASKS", "16")
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "16")
    assert started_outside() == "slurm"
    require_startable(DDP | {"num_nodes": 2, "devices": 8}, stage=stage, sweep=sweep)
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "none")
    monkeypatch.setenv("WORLD_SIZE", "8")
    assert started_outside() == "torchrun"
    for devices in ("auto", -1, 8, "8", [0, 1, 2, 3, 4, 5, 6, 7], "0,1,2,3,4,5,6,7"):
        require_startable(DDP | {"devices": devices}, stage=stage, sweep=sweep)


@pytest.mark.parametrize(
    "trainer",
    [
        ONE,
        ONE | {"devices": "auto"},
        DDP | {"devices": 4},
        DDP | {"devices": [3]},
        DDP | {"devices": 8, "num_nodes": 2},
    ],
)
@pytest.mark.parametrize(
    "outside",
    [
        {"TORCHELASTIC_RUN_ID": "none", "WORLD_SIZE": "8"},
        {"SLURM_NTASKS": "8", "SLURM_STEP_NUM_TASKS": "8"},
        # srun within salloc, where Lightning does not look at SLURM.
        {"SLURM_NTASKS": "8", "SLURM_STEP_NUM_TASKS": "8", "SLURM_JOB_NAME": "interactive"},
    ],
)
def test_ranks_from_outside_that_the_trainer_does_not_have_are_refused(
    trainer: dict[str, object], outside: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in outside.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(Unsupported, match=r"ranks: 8 processes were started .* torchrun"):
        require_startable(trainer, stage="implicit", sweep=False)


def test_one_process_in_a_job_of_many_tasks_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_NTASKS", "8")
    require_startable(ONE, stage="all", sweep=True)
    monkeypatch.setenv("SLURM_JOB_NAME", "bash")
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "8")
    monkeypatch.setenv("SLURM_PTY_PORT", "4000")
    require_startable(ONE, stage="all", sweep=True)


def test_a_list_of_one_device_is_one_process() -> None:
    require_startable(ONE | {"devices": [3]}, stage="all", sweep=True)
    with pytest.raises(Unsupported, match="stage=all"):
        require_startable(ONE | {"devices": [0, 3]}, stage="all", sweep=False)


def test_a_trainer_within_a_pipeline_is_looked_at_before_the_first_stage(tmp_path: Path) -> None:
    stages = "pipeline=[['stage=augment'],['stage=implicit','trainer=ddp']]"
    with pytest.raises(Unsupported, match="stage=all: a trainer of several processes"):
        run_here(*smoke_words(tmp_path), stages)
    assert not list(tmp_path.iterdir())


def test_one_task_of_slurm_has_no_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLURM_NTASKS", "1")
    with pytest.raises(Unsupported, match="one task of SLURM was found, one for each device"):
        require_startable(DDP, stage="implicit", sweep=False)
    require_startable(DDP | {"devices": 1}, stage="implicit", sweep=False)
    monkeypatch.setenv("SLURM_JOB_NAME", "bash")
    assert started_outside() is None
    require_startable(DDP, stage="implicit", sweep=False)


def row(item: str) -> Row:
    return {"id": item}


def test_ranks_share_all_items_and_the_cores_of_their_machine(tmp_path: Path) -> None:
    items = [f"item{k}" for k in range(10)]
    seen = []
    for rank in range(4):
        data = ItemsModule(task=row, items=items, folder=tmp_path, workers=Workers(8))
        # Two machines of two ranks each.
        data.trainer = SimpleNamespace(global_rank=rank, world_size=4, num_devices=2)
        rows = data.predict_dataloader().dataset
        assert rows.workers.count(rows.ranks) == 4
        seen += rows.items
    assert sorted(seen) == sorted(items)


def test_a_launcher_that_is_not_installed_names_the_command() -> None:
    error = MissingConfigException("", "hydra/launcher/submitit_slurm", ["basic"])
    assert hydra_line(error) == (
        "hydra/launcher=submitit_slurm: the package 'hydra-submitit-launcher' is not installed; "
        "it is required; type: pip install 'gensp[slurm]'"
    )


SUBMITTED = ("-m", "hydra/launcher=submitit_local", "hydra.launcher.timeout_min=10")


@pytest.mark.slow
def test_a_sweep_is_submitted(tmp_path: Path) -> None:
    stages = "pipeline=[['stage=augment'],['stage=implicit','recipe.implicit.epochs=2']]"
    words = (*smoke_words(tmp_path), stages, "workers.jobs=1", "name=one,two")
    train(*SUBMITTED, *words)
    for made in ("one/full/augment", "one/full/implicit", "two/full/implicit"):
        manifest = json.loads((tmp_path / made / "manifest.json").read_text())
        assert manifest["ranks"] == 1
    assert len(list(tmp_path.glob("smoke/.submitit/*/*_submitted.pkl"))) == 2


# What srun tells its tasks, in the words of submitit's local executor.
AS_SLURM = {
    "SLURM_PROCID": "${oc.env:SUBMITIT_LOCAL_GLOBALID}",
    "SLURM_LOCALID": "${oc.env:SUBMITIT_LOCAL_LOCALID}",
    "SLURM_NTASKS": "${oc.env:SUBMITIT_LOCAL_NTASKS}",
    "SLURM_NTASKS_PER_NODE": "${oc.env:SUBMITIT_LOCAL_NTASKS}",
    "SLURM_STEP_NUM_TASKS": "${oc.env:SUBMITIT_LOCAL_NTASKS}",
    "SLURM_JOB_NUM_NODES": "${oc.env:SUBMITIT_LOCAL_JOB_NUM_NODES}",
    "SLURM_NODEID": "${oc.env:SUBMITIT_LOCAL_NODEID}",
    "SLURM_JOB_ID": "7",
    "SLURM_JOB_NAME": "train",
    "SLURM_JOB_NODELIST": "127.0.0.1",
}


@pytest.mark.slow
def test_tasks_of_a_submitted_job_are_the_ranks_of_trainer_slurm(smoke_copy: Path) -> None:
    told = [f"++hydra.job.env_set.{name}='{value}'" for name, value in AS_SLURM.items()]
    port = f"++hydra.job.env_set.MASTER_PORT='{free_port()}'"
    ranks = ("hydra.launcher.tasks_per_node=2", "trainer=slurm", "trainer.accelerator=cpu")
    stage = ("stage=implicit", "recipe.implicit.epochs=2", "force=true")
    train(*SUBMITTED, *told, port, *ranks, *smoke_words(smoke_copy), *stage)
    folder = smoke_copy / "smoke" / "full" / "implicit"
    assert json.loads((folder / "manifest.json").read_text())["ranks"] == 2
    assert len((folder / "history.csv").read_text().splitlines()) == 3


@pytest.mark.slow
def test_a_submitted_trainer_of_several_processes_is_refused(tmp_path: Path) -> None:
    done = train(*SUBMITTED, *smoke_words(tmp_path), "stage=augment", "trainer=ddp_cpu", code=1)
    assert "error: -m: a trainer of several processes was found" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "smoke" / "full").exists()
