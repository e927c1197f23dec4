"""The configuration: every combination composes, and every key is an argument of something."""

import inspect
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from commands import ROOT, STAGES, train
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf

from gensp.configuration import settings_of
from gensp.geometry.guided_registration import PATIENT
from gensp.restarts import differences

CONF = ROOT / "conf"


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


@pytest.fixture(autouse=True)
def _composer() -> Iterator[None]:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


def composed(*words: str) -> DictConfig:
    return compose("config", overrides=list(words))


def targets(node: Any) -> Iterator[dict[str, Any]]:
    """Every node that names a callable, nested ones included."""
    if isinstance(node, dict):
        if "_target_" in node:
            yield node
        for value in node.values():
            yield from targets(value)
    elif isinstance(node, list):
        for value in node:
            yield from targets(value)


def misplaced(node: dict[str, Any]) -> set[str]:
    """Keys that the node's callable does not take, as far as its signature tells."""
    keys = {key for key in node if not (key.startswith("_") and key.endswith("_"))}
    called = get_object(node["_target_"])
    owner = getattr(called, "__self__", None)
    # `from_runs` hands its **keywords to the constructors of its class.
    chain = [called, *(base.__init__ for base in owner.__mro__)] if owner else [called]
    taken: set[str] = set()
    for function in chain:
        parameters = inspect.signature(function).parameters.values()
        taken |= {p.name for p in parameters if p.kind is not p.VAR_KEYWORD}
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            return keys - taken
        if called.__name__ != "from_runs":
            return set()
    return keys - taken


def check(cfg: DictConfig) -> None:
    plain = OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)
    for node in targets(plain):
        assert not misplaced(node), f"{node['_target_']}: {misplaced(node)}"


COMBINATIONS = list(itertools.product(STAGES, choices("ablation"), choices("model/generator")))


@pytest.mark.parametrize(("stage", "ablation", "generator"), COMBINATIONS)
def test_networks(stage: str, ablation: str, generator: str) -> None:
    words = (f"stage={stage}", f"ablation={ablation}", f"model/generator={generator}")
    cfg = composed(*words)
    check(cfg)
    assert cfg.stage.name == stage
    assert cfg.stage.verb in ("fit", "predict")
    assert set(cfg.stage.needs) <= set(STAGES[: STAGES.index(stage)])


@pytest.mark.parametrize("stage", ["parameterize", "evaluate"])
@pytest.mark.parametrize("method", choices("method"))
@pytest.mark.parametrize("fit", choices("fit"))
@pytest.mark.parametrize("refine", choices("refine"))
def test_maps(stage: str, method: str, fit: str, refine: str) -> None:
    check(composed(f"stage={stage}", f"method={method}", f"fit={fit}", f"refine={refine}"))


@pytest.mark.parametrize("shapes", choices("shapes"))
def test_collections(shapes: str) -> None:
    named = composed(f"shapes={shapes}").shapes
    root = ["shapes.root=meshes"] if OmegaConf.is_missing(named, "root") else []
    check(composed("stage=augment", f"shapes={shapes}", *root))


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("recipe", choices("recipe"))
def test_recipes_fill_every_stage(stage: str, recipe: str) -> None:
    check(composed(f"stage={stage}", f"recipe={recipe}"))


@pytest.mark.parametrize(
    "group", ["trainer", "compute", "logger", "callbacks", "debug", "experiment"]
)
def test_surroundings(group: str) -> None:
    for choice in choices(group):
        check(composed("stage=implicit", f"{group}={choice}", "++shapes.root=meshes"))


@pytest.mark.parametrize("recipe", choices("recipe"))
@pytest.mark.parametrize("generator", choices("model/generator"))
def test_networks_are_made(recipe: str, generator: str) -> None:
    cfg = composed(f"recipe={recipe}", f"model/generator={generator}")
    for node in cfg.model.values():
        assert instantiate(node, _convert_="all").settings["latent"] == cfg.recipe.model.latent


def test_pipelines_name_stages() -> None:
    for experiment in choices("experiment"):
        for entry in composed(f"experiment={experiment}").pipeline:
            check(composed(f"experiment={experiment}", *entry, "++shapes.root=meshes"))


def keys_of(node: Any, prefix: str = "") -> set[str]:
    if not isinstance(node, dict):
        return {prefix}
    return set().union(*(keys_of(value, f"{prefix}.{key}") for key, value in node.items()))


def test_recipes_have_the_same_keys() -> None:
    recipes = {
        name: keys_of(OmegaConf.to_container(composed(f"recipe={name}").recipe))
        for name in choices("recipe")
    }
    assert set(recipes) == {"paper", "quick", "cpu", "cpu_humans", "smoke"}
    for name, keys in recipes.items():
        assert keys == recipes["paper"], name


def test_the_patient_schedule_is_that_of_the_recipes() -> None:
    for recipe in ("paper", "quick", "cpu"):
        schedule = composed(f"recipe={recipe}").recipe.correspond.paired_schedule
        assert tuple(map(tuple, schedule)) == PATIENT


@pytest.mark.parametrize("experiment", choices("experiment"))
def test_no_experiment_changes_how_a_recipe_learns(experiment: str) -> None:
    """What is measured and drawn, and how many failures are borne, is an experiment's to say."""

    def learning(*words: str) -> dict:
        recipe = OmegaConf.to_container(composed(*words).recipe)
        for part in ("evaluate", "pictures"):
            del recipe[part]
        del recipe["parameterize"]["max_failures"]
        return recipe

    assert learning(f"experiment={experiment}", "recipe=paper") == learning("recipe=paper")


def reads() -> dict[str, set[str]]:
    """Interpolated key → files of conf/ that read it."""
    found: dict[str, set[str]] = {}
    for path in CONF.rglob("*.yaml"):
        for key in re.findall(r"\$\{([a-z][\w.]*)\}", path.read_text()):
            found.setdefault(key, set()).add(path.relative_to(CONF).as_posix())
    return found


def test_every_recipe_key_is_read() -> None:
    read = {key for key in reads() if key.startswith("recipe.")}
    recipe = OmegaConf.to_container(OmegaConf.load(CONF / "recipe" / "paper.yaml"))
    text = "".join(path.read_text() for path in CONF.rglob("*.yaml"))
    for key in keys_of(recipe, "recipe"):
        parents = {key.rsplit(".", cut)[0] for cut in range(key.count("."))}
        # Keys that hold the name of a stage or of a fit.
        chosen = (
            re.sub(r"^recipe\.\w+\.", "${recipe.${stage.name}.", key) + "}",
            "${" + key.rsplit(".", 1)[0] + ".${fit.name}}",
        )
        assert parents & read or any(word in text for word in chosen), key


def test_each_ablation_switch_is_read_where_it_belongs() -> None:
    read = reads()
    assert read["ablation.data_augmentation"] == {"data/sdf.yaml"}
    assert read["ablation.guided_paths"] == {"correspond/tree.yaml", "correspond/paired.yaml"}
    assert read["ablation.geometric_regularization"] == {
        "stage/implicit.yaml",
        "stage/finetune.yaml",
    }


def test_ablations_share_only_what_their_switch_leaves_alone() -> None:
    def settings(stage: str, ablation: str) -> Any:
        cfg = composed(f"stage={stage}", f"ablation={ablation}")
        nodes = {"stage": cfg.stage, "data": cfg.data, "trainer": cfg.trainer}
        return {name: OmegaConf.to_container(node, resolve=True) for name, node in nodes.items()}

    for ablation in choices("ablation"):
        for stage, variant in composed(f"ablation={ablation}").ablation.shares.items():
            assert settings(stage, ablation) == settings(stage, variant), (ablation, stage)


def test_accumulated_batches_are_the_settings_of_one() -> None:
    words = ("stage=implicit", "recipe=paper", "recipe.implicit.batch=48")
    accumulated = settings_of(composed(*words, "trainer.accumulate_grad_batches=2"), {})
    assert accumulated == settings_of(composed(*words[:2]), {})
    assert accumulated != settings_of(composed(*words), {})


def test_compilation_is_a_setting_of_trainings_where_it_is_on() -> None:
    plain = settings_of(composed("stage=implicit"), {})
    assert "compile" not in plain
    compiled = settings_of(composed("stage=implicit", "compile=true"), {})
    assert compiled == plain | {"compile": True}
    assert differences(plain, compiled) == ["compile: nothing → True"]
    items = settings_of(composed("stage=parameterize"), {})
    assert settings_of(composed("stage=parameterize", "compile=true"), {}) == items


@pytest.mark.parametrize("compute", choices("compute"))
def test_where_work_runs_decides_no_number(compute: str) -> None:
    words = ("stage=correspond", "recipe=smoke")
    elsewhere = composed(*words, f"compute={compute}", "workers.jobs=3")
    assert elsewhere.data.workers.jobs == 3
    assert "compute" not in elsewhere
    assert settings_of(elsewhere, {}) == settings_of(composed(*words), {})


def test_a_misspelt_key_is_refused() -> None:
    with pytest.raises(ConfigCompositionException, match="sede"):
        composed("sede=1")


def test_help_lists_stages_and_switches() -> None:
    text = train("--help").stdout
    for word in (*STAGES, "no_gp", "wandb_offline", "trainer=ddp", "debug=fast"):
        assert word in text


def test_configuration_is_a_package_that_is_installed() -> None:
    script = "import conf, pathlib; print(pathlib.Path(conf.__file__).parent)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert (Path(done.stdout.strip()) / "config.yaml").is_file()
