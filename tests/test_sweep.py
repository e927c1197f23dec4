"""Sweeps: one folder per variant, shared stages made once, a failed job stops no other."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from commands import ROOT, STAGES, environment, smoke_words, train
from hydra import compose, initialize_config_dir

from gensp.configuration import runs_of, settings_of
from gensp.sweeps import named, with_swept

pytestmark = pytest.mark.slow

ABLATIONS = ("full", "no_da", "no_gp", "no_gr")


def test_all_ablations_by_one_command(smoke_copy: Path) -> None:
    # Certified: a model of two minutes leaves more folds than untangling can undo.
    words = (*smoke_words(smoke_copy), "refine=certify")
    done = train("-m", *words, f"ablation={','.join(ABLATIONS)}")
    runs = smoke_copy / "smoke"
    made = {path.parent.relative_to(runs).as_posix() for path in runs.glob("*/*/manifest.json")}
    shared = {"no_da/augment", "no_gp/augment", "no_gp/implicit", "no_gr/augment"}
    learnt = {f"{name}/{stage}" for name in ABLATIONS for stage in STAGES[:5]}
    maps = {f"{name}+certify/{stage}" for name in ABLATIONS for stage in STAGES[5:]}
    assert (learnt | maps) - shared <= made
    assert not shared & made
    # What was there before is kept, and says so.
    assert done.stdout.count("finished before") == 5 + len(shared)
    for name in ABLATIONS:
        table = json.loads((runs / f"{name}+certify/evaluate/summary.json").read_text())
        assert table["variant"] == f"{name}+certify"
        assert 0 < table["groups"]["all"]["error"] < 0.5
        assert table["groups"]["all"]["bad_faces_percent"] == 0
        assert table["groups"]["all"]["affected_shapes"] == 0
    lines = (runs / "summary.md").read_text()
    assert all(f"{name}+certify" in lines for name in ABLATIONS)


def test_a_failed_job_stops_no_other(tmp_path: Path) -> None:
    done = train("-m", *smoke_words(tmp_path), "stage=correspond,augment", code=1)
    assert "'correspond' needs 'augment'" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "smoke/full/augment/manifest.json").is_file()


def test_a_sweep_over_a_weight_has_a_folder_for_each_value(smoke_copy: Path) -> None:
    key = "recipe.finetune.isometry_weight"
    stages = ",".join(f"['stage={name}']" for name in STAGES[3:])
    fixed = (*smoke_words(smoke_copy), "workers.jobs=1", "logger=none", "recipe.finetune.epochs=2")
    done = train("-m", *fixed, "refine=certify", f"pipeline=[{stages}]", f"{key}=0.01,1.0")
    # The networks of the stages before are those that were there.
    assert done.stdout.count("finished before, kept") == 2
    runs = smoke_copy / "smoke"
    for value in (0.01, 1.0):
        learnt = runs / f"full+finetune.isometry_weight-{value}" / "finetune"
        stored = json.loads((learnt / "manifest.json").read_text())
        assert stored["settings"]["stage"]["module"]["isometry_weight"] == value
        maps = runs / f"full+certify+finetune.isometry_weight-{value}"
        table = json.loads((maps / "evaluate" / "summary.json").read_text())
        assert table["variant"] == maps.name
    # The same by hand, without -m.
    again = train(*fixed, "stage=finetune", f"{key}=1.0", f"swept=[{key}]")
    assert "finished before, kept" in again.stdout
    both = [str(runs / f"full+finetune.isometry_weight-{value}") for value in (0.01, 1.0)]
    compare = [sys.executable, "-m", "gensp", "runs", "compare", *both]
    compared = subprocess.run(
        compare, cwd=ROOT, env=environment(), capture_output=True, text=True, check=True
    )
    assert "stage.module.isometry_weight" in compared.stdout
    assert "val/sigma" in compared.stdout


SYMBOLS = {
    "λ": ("recipe.implicit.encoder_weight", "implicit"),
    "μ": ("recipe.implicit.deformation_weight", "implicit"),
    "μ̄": ("recipe.finetune.deformation_weight", "finetune"),
    "β": ("recipe.finetune.isometry_weight", "finetune"),
    "γ": ("recipe.refine.pull.none", "parameterize"),
    "n": ("recipe.correspond.registration.interpolants", "correspond"),
}


@pytest.mark.parametrize("symbol", SYMBOLS)
def test_every_symbol_has_one_key_that_names_the_folders_it_changes(symbol: str) -> None:
    key, first = SYMBOLS[symbol]
    words = with_swept(["-m", f"{key}=1,2", "stage=all", "recipe.augment.samples=3"])
    assert words[-1] == f"swept=[{key}]"
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        cfgs = [
            compose("config", overrides=["experiment=smoke", f"{key}={value}", words[-1]])
            for value in (1, 2)
        ]
        stages = {
            stage: [
                compose(
                    "config", overrides=["experiment=smoke", f"stage={stage}", f"{key}={value}"]
                )
                for value in (1, 2)
            ]
            for stage in STAGES
        }
    one, two = (runs_of(cfg) for cfg in cfgs)
    apart = [stage for stage in STAGES if one.folder(stage) != two.folder(stage)]
    assert apart == list(STAGES[STAGES.index(first) :])
    # What shares a folder has the same settings.
    for stage in set(STAGES) - set(apart):
        settings = [settings_of(cfg, {}) for cfg in stages[stage]]
        assert settings[0] == settings[1]
    text = (ROOT / "docs" / "stages.md").read_text()
    assert f"`{key}`" in text


def test_words_that_name_no_folder() -> None:
    assert with_swept(["stage=all", "seed=1"]) == ["stage=all", "seed=1"]
    assert with_swept(["-m", "shapes=heads,quadrupeds"]) == ["-m", "shapes=heads,quadrupeds"]
    assert with_swept(["-m", "seed=0,1", "recipe.model.latent=8,9"])[-1] == (
        "swept=[seed,recipe.model.latent]"
    )
    given = ["-m", "seed=0,1", "swept=[seed]"]
    assert with_swept(given) == given
    broken = ["-m", "seed=[0,1"]
    assert with_swept(broken) == broken


def test_a_mistyped_key_of_a_sweep_is_told(smoke: Path) -> None:
    done = train(*smoke_words(smoke), "stage=finetune", "swept=[shapes]", code=2)
    assert "swept: has 'shapes'; keys of recipe.* with a value, or seed" in done.stderr


def test_every_value_of_a_sweep_has_a_name_of_its_own_in_wandb() -> None:
    names = set()
    words = ("experiment=smoke", "logger=wandb_offline", "stage=parameterize")
    swept = ("swept=[recipe.finetune.isometry_weight]", "recipe.finetune.isometry_weight=")
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        for more in ((), (swept[0], f"{swept[1]}0.1"), (swept[0], f"{swept[1]}1.0")):
            for refine in ("newton", "certify"):
                cfg = compose("config", overrides=[*words, f"refine={refine}", *more])
                runs = runs_of(cfg)
                name = named(cfg, runs.variant_of("parameterize")).logger.wandb.name
                assert runs.folder("parameterize").as_posix().endswith(name)
                names.add(name)
    assert len(names) == 6
