"""What a configuration says, and what must be right about it before anything is computed.

Needs neither torch nor Lightning, so that what is wrong is told at once.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationKeyError

from gensp.errors import GenSPError, MissingData, Unsupported
from gensp.files import read_yaml
from gensp.runs import Run, Runs
from gensp.sweeps import suffixes

# Every key of a recipe, with a value of its kind.
_PAPER = Path(__file__).parents[1] / "conf/recipe/paper.yaml"

_TRAINER_SCIENCE = (
    "max_epochs",
    "max_steps",
    "precision",
    "accumulate_grad_batches",
    "gradient_clip_val",
    "limit_train_batches",
    "overfit_batches",
    "fast_dev_run",
)

# Experiments of the package; those of others may be called anything.
_EXPERIMENTS = _PAPER.parents[1] / "experiment"

# Whole numbers, and the least that each may be.
_COUNTS = {"seed": 0, "threads": 0, "workers.jobs": 0}
_SHAPES_PATHS = ("root", "keypoints", "split_file")


def require_taken(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Refuse what was asked for and would be ignored.

    Raises
    ------
    Unsupported
        A fit or a refinement was typed that the method does not take.
    """
    method = cfg.method.name
    for part in ("fit", "refine"):
        typed = [word for word in overrides if re.match(rf"\+*{part}[.=]", word)]
        if typed and part not in cfg.method.takes:
            takes = (
                ", ".join(f"{word}=" for word in cfg.method.takes) or "neither fit= nor refine="
            )
            raise Unsupported(
                f"{typed[0]}: was found with method={method}, which takes {takes}; leave it out, "
                f"or choose method=gensp"
            )


def require_name(cfg: DictConfig, overrides: Sequence[str]) -> None:
    """Keep runs of other shapes out of the folder of an experiment.

    Raises
    ------
    Unsupported
        No name was found, or that of an experiment whose shapes are not those that were typed.
    """
    typed = dict(word.lstrip("+").split("=", 1) for word in overrides if "=" in word)
    if not str(cfg.name).strip():
        raise Unsupported("name: is empty; a name is required; add name=NAME")
    own = _shapes_of(typed.get("experiment", "quickstart"))
    if "name" in typed or typed.get("shapes", own) == own or cfg.shapes.name in cfg.name:
        return
    raise Unsupported(
        f"shapes={typed['shapes']}: the run would be named {cfg.name}, as those of shapes={own}; "
        "a name of its own is required; add name=NAME"
    )


def _shapes_of(experiment: str) -> str | None:
    """The collection that an experiment of the package is of; none, if it leaves that open."""
    path = _EXPERIMENTS / f"{experiment}.yaml"
    words = read_yaml(path).get("defaults", ()) if path.is_file() else ()
    return next((word["override /shapes"] for word in words if "override /shapes" in word), None)


def require_values(cfg: DictConfig) -> None:
    """Refuse a configuration with a value missing, or with a word that its table does not have.

    Raises
    ------
    MissingData, Unsupported
        The key, and what it may hold.
    """
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
    except InterpolationKeyError as error:
        raise Unsupported(_unknown_word(cfg, str(error))) from None
    if missing:
        raise MissingData(
            f"{', '.join(missing)}: no value was given; one is required; add {missing[0]}=VALUE"
        )


def require_numbers(cfg: DictConfig) -> None:
    """Refuse what is no number: seed, threads, jobs, and where the paper's recipe has one.

    Raises
    ------
    Unsupported
        The key, what was found, and a value that it may hold.
    """
    for key, least in _COUNTS.items():
        value = OmegaConf.select(cfg, key)
        whole = isinstance(value, int) and not isinstance(value, bool)
        if value is not None and not (whole and value >= least):
            raise Unsupported(
                f"{key}: is '{value}'; a whole number from {least} on is required; correct it"
            )
    known = OmegaConf.load(_PAPER)
    pending = [("recipe", cfg.recipe, known)]
    while pending:
        name, found, model = pending.pop()
        for key in model:
            value, example, place = found.get(key), model.get(key), f"{name}.{key}"
            if isinstance(example, DictConfig) and isinstance(value, DictConfig):
                pending.append((place, value, example))
            elif isinstance(value, str) and isinstance(example, int | float):
                raise Unsupported(
                    f"{place}: is '{value}'; a value such as {example} is required; correct it"
                )


def _unknown_word(cfg: DictConfig, complaint: str) -> str:
    """What to tell when a key holds a word that a table of the configuration does not have."""
    found = re.search(r"'([^']+)' not found", complaint)
    words = found.group(1).split(".") if found else []
    for place, word in enumerate(words):
        table = ".".join(words[:place])
        known = OmegaConf.select(cfg, table) if table else cfg
        if word not in known:
            return f"{table}: has no '{word}'; one of {', '.join(map(str, known))} is required"
    return complaint.splitlines()[0]


def runs_of(cfg: DictConfig, overrides: Sequence[str] = ()) -> Runs:
    """The folders that a configuration reads and writes."""
    words = [word for word in overrides if not word.startswith(("stage=", "force=", "debug="))]
    maps = {"parameterize": cfg.method.variant, "evaluate": cfg.method.variant}
    own = {**maps, **cfg.ablation.shares}
    swept = suffixes(cfg)
    named = {stage: own.get(stage, cfg.ablation.name) + more for stage, more in swept.items()}
    return Runs(
        root=Path(cfg.paths.runs),
        experiment=cfg.name,
        variant=cfg.ablation.name,
        shares=own | named,
        inputs=dict(cfg.inputs),
        outputs={"prepare": cfg.prepare.out},
        command=" ".join(["python train.py", *(words or [f"experiment={cfg.name}"])]),
    )


def settings_of(cfg: DictConfig, inputs: Mapping[str, Run]) -> dict[str, Any]:
    """What decides the numbers: stage, data, seed, what was read; no machine, no path."""
    bare = cfg.copy()
    OmegaConf.set_struct(bare, False)
    bare.paths = {key: f"<{key}>" for key in cfg.paths}
    bare.workers = None
    trainer: Any = OmegaConf.to_container(bare.trainer, resolve=True)
    data = _without_workers(OmegaConf.to_container(bare.data, resolve=True))
    _one_batch(data, trainer)
    stage: Any = OmegaConf.to_container(bare.stage, resolve=True)
    _without_off(stage.get("module") or {}, data, paired=cfg.correspond.name == "paired")
    # Left out while it is off, as in runs that were made before it was a setting.
    compiled = {"compile": True} if cfg.compile and cfg.stage.verb == "fit" else {}
    # Only stages whose work names the collection read its files; the others see it by `inputs`.
    reads = "collection" in (cfg.data.get("task") or {})
    return {
        "stage": stage,
        "data": data,
        "trainer": {key: trainer.get(key) for key in _TRAINER_SCIENCE},
        **compiled,
        "seed": cfg.seed,
        "shapes": made(cfg.shapes).fingerprint if reads else None,
        "inputs": {name: found.outputs for name, found in inputs.items()},
    }


def _without_off(module: dict[str, Any], data: dict[str, Any], *, paired: bool) -> None:
    """Leave out what is off, as in runs that were made before these were settings."""
    sampler = data.get("sampler") or {}
    for table, key in ((module, "tolerance"), (sampler, "thinness")):
        if table.get(key) == 0:
            del table[key]
    # Paired surfaces were placed by Stage III-a; the trainings after it place nothing.
    if paired and "PairedStage" not in str(module.get("_target_")):
        module.pop("placement", None)


def placed(cfg: DictConfig) -> DictConfig:
    """The configuration with absolute paths, for workers that were started in another folder.

    What is remembered of a run is taken from `cfg`, whose paths are as they were typed.
    """
    found: DictConfig = cfg.copy()
    for table, keys in ((found.paths, list(found.paths)), (found.shapes, _SHAPES_PATHS)):
        for key in keys:
            if isinstance(table.get(key), str):
                table[key] = str(Path(table[key]).absolute())
    return found


def _one_batch(data: dict[str, Any], trainer: dict[str, Any]) -> None:
    """Accumulated batches are one: as with ranks, how it is shared out decides no number."""
    if "batching" in data:
        data["batching"]["size"] *= trainer["accumulate_grad_batches"]
    trainer["accumulate_grad_batches"] = 1


def _without_workers(node: Any) -> Any:
    if isinstance(node, dict):
        return {
            key: _without_workers(value)
            for key, value in node.items()
            if key not in ("workers", "num_workers", "store")
        }
    return [_without_workers(value) for value in node] if isinstance(node, list) else node


def made(node: DictConfig, **given: Any) -> Any:
    """The object that a node of the configuration describes; its own errors come out bare."""
    try:
        return instantiate(node, _partial_=True, _convert_="all")(**given)
    except InstantiationException as error:
        if isinstance(error.__cause__, GenSPError | OSError):
            raise error.__cause__ from None
        raise
