"""What a person reads when a run cannot go on: one line, exit code 2, nothing half written."""

import errno
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from commands import ROOT, command, environment, run_here, smoke_words, train
from omegaconf import OmegaConf

from gensp.errors import MissingData, OutputError, StaleRun, Unsupported
from gensp.files import atomic_path
from gensp.geometry.mesh import Mesh, save_mesh
from gensp.geometry.sphere import icosphere
from gensp.run import _output_errors
from gensp.terminal import complain


def complaint(*words: str) -> str:
    done = train(*words, code=2)
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


def test_missing_stage_names_the_command(tmp_path: Path) -> None:
    line = complaint(*smoke_words(tmp_path), "stage=correspond")
    assert line.startswith("error: 'correspond' needs 'augment', but ")
    assert "has no manifest.json; run: python train.py experiment=smoke" in line
    assert line.endswith("stage=augment")


def test_bad_meshes_name_the_ways_out(tmp_path: Path) -> None:
    _write_open(tmp_path / "cup.ply")
    words = ("shapes=folder", f"shapes.root={tmp_path}", "name=cups", "stage=augment")
    done = train(*words, f"paths.runs={tmp_path}/runs", f"paths.cache={tmp_path}/cache", code=2)
    head, line = done.stderr.splitlines()
    assert head.startswith("error: 1 of 1 meshes cannot be used; ")
    assert head.endswith("leave them out with shapes.on_bad=skip:")
    assert line.endswith(f"or type: gensp repair {tmp_path}/cup.ply cup_mended.ply")


def _write_open(path: Path) -> None:
    ball = icosphere(2)
    save_mesh(Mesh(ball.vertices, ball.faces[1:]), path)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ("stage=implict",),
            "stage=implict: stage has no 'implict'; one of all, augment, correspond, evaluate, "
            "finetune, implicit, initialize, parameterize, prepare is required; did you mean "
            "stage=implicit?",
        ),
        (
            ("shapes.rot=x",),
            "shapes.rot: shapes has no 'rot'; one of name, root, on_bad, max_faces, up, cache is "
            "required; did you mean shapes.root?",
        ),
        (
            ("recipe.implicit.epoch=3",),
            "recipe.implicit.epoch: recipe.implicit has no 'epoch'; python train.py --help lists "
            "them; did you mean recipe.implicit.epochs?",
        ),
        (
            ("model/encodr=pointnet2",),
            "model/encodr: the configuration has no 'model/encodr'; one of model/encoder, "
            "model/implicit, model/generator is required; did you mean model/encoder?",
        ),
        (("-m", "stge=all"), "stge: .*; did you mean stage[?]"),
        (("foo",), "foo: cannot be read; key=value or group=choice is required"),
        (
            ("stage=augment,implicit",),
            "stage=augment,implicit: several values; one is required; add -m to run one after "
            "the other",
        ),
    ],
)
def test_misspelt_words_name_the_nearest(words: tuple[str, ...], line: str) -> None:
    found = complaint(*words)
    assert found == f"error: {line}" or re.fullmatch(f"error: {line}", found)


def test_what_is_wrong_is_told_without_torch(tmp_path: Path) -> None:
    script = (
        "import sys\n"
        "for name in ('torch', 'lightning', 'matplotlib'): sys.modules[name] = None\n"
        "sys.path.insert(0, 'tests')\n"
        "from commands import run_here\n"
        "from gensp.errors import GenSPError\n"
        "for words in (['stage=correspond'], ['stage=augment', 'shapes=folder',\n"
        "              'shapes.root=no'], ['stage=parameterize', 'method=arap',\n"
        "              'method.start=foo']):\n"
        "    try: run_here('experiment=smoke', 'paths.runs=" + str(tmp_path) + "', *words)\n"
        "    except GenSPError as error: print(type(error).__name__)\n"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.stdout.split() == ["MissingStage", "MissingData", "Unsupported"], done.stderr


def test_other_settings_are_named(smoke: Path) -> None:
    with pytest.raises(StaleRun) as caught:
        run_here(*smoke_words(smoke), "stage=augment", "recipe.augment.samples=5")
    line = str(caught.value)
    assert "made with other settings (data.task.samples: " in line
    assert "→ 5" in line
    assert line.endswith("add force=true to make it anew, or name=NEW to keep both")


def test_other_predecessor_is_named(smoke_copy: Path) -> None:
    words = smoke_words(smoke_copy)
    run_here(*words, "stage=augment", "force=true", "recipe.augment.samples=3")
    with pytest.raises(StaleRun, match=r"of stage augment .* stage=implicit force=true"):
        run_here(*words, "stage=implicit")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ("method=arap", "method.start=foo"),
            "method.starts: has no 'foo'; one of cmcf, dirichlet is required",
        ),
        (
            ("method=external", "method.tool=foo"),
            "method.tools: has no 'foo'; one of SphereMap, SphereParam, SphereEmbedding is "
            "required",
        ),
    ],
)
def test_unknown_word_lists_the_known_ones(words: tuple[str, ...], line: str) -> None:
    with pytest.raises(Unsupported) as caught:
        run_here("stage=parameterize", *words)
    assert str(caught.value) == line


@pytest.mark.parametrize(
    "word", ["seed=abc", "workers.jobs=many", "workers.jobs=-3", "threads=1.5"]
)
def test_what_counts_is_a_whole_number(tmp_path: Path, word: str) -> None:
    key, value = word.split("=")
    with pytest.raises(Unsupported, match=f"{key}: is '{value}'; a whole number from 0 on"):
        run_here(*smoke_words(tmp_path), "stage=augment", word)


def test_a_pipeline_that_keeps_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=r"keep: is false, .*; add stage=NAME"):
        run_here(*smoke_words(tmp_path), "debug=fast")


@pytest.mark.parametrize(
    ("word", "line"),
    [
        ("finetune.isometry_weight=abc", "is 'abc'; a value such as 0.01"),
        ("implicit.sdf.near=many", "is 'many'; a value such as 50000"),
        ("finetune.train_encoder=maybe", "is 'maybe'; a value such as True"),
    ],
)
def test_a_word_in_place_of_a_number_is_told_before_anything_runs(word: str, line: str) -> None:
    key = word.split("=")[0]
    with pytest.raises(Unsupported, match=re.escape(f"recipe.{key}: {line} is required")):
        run_here(f"recipe.{word}")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("method=arap", "refine=certify"), "refine=certify: .*arap, which takes neither fit="),
        (
            ("method=cmcf", "refine=none", "fit=register"),
            "fit=register: .*cmcf, which takes refine=",
        ),
    ],
)
def test_what_a_method_would_ignore_is_refused(words: tuple[str, ...], line: str) -> None:
    with pytest.raises(Unsupported, match=line):
        run_here("stage=parameterize", *words)


def test_missing_value_is_asked_for() -> None:
    with pytest.raises(MissingData) as caught:
        run_here("stage=augment", "shapes=folder")
    assert str(caught.value) == (
        "shapes.root: no value was given; one is required; add shapes.root=VALUE"
    )


def test_other_shapes_do_not_go_into_the_folder_of_an_experiment(tmp_path: Path) -> None:
    words = (f"paths.runs={tmp_path}", "stage=augment", "shapes=folder")
    with pytest.raises(Unsupported) as caught:
        run_here(*words, f"shapes.root={ROOT / 'data/heads'}")
    assert str(caught.value) == (
        "shapes=folder: the run would be named quickstart, as those of shapes=heads; "
        "a name of its own is required; add name=NAME"
    )
    with pytest.raises(Unsupported, match="name: is empty"):
        run_here(f"paths.runs={tmp_path}", "stage=augment", "name=")
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
@pytest.mark.parametrize("words", [("stage=implicit",), ("stage=all",)])
def test_a_gpu_that_is_not_there_is_told_before_anything_begins(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    with pytest.raises(Unsupported, match=r"no GPU that torch can use was found; .* trainer=cpu"):
        run_here("experiment=smoke", "trainer=gpu", f"paths.runs={tmp_path}", *words)
    assert not list(tmp_path.iterdir())


def test_mistyped_folder_leaves_no_trace(tmp_path: Path) -> None:
    words = (f"paths.runs={tmp_path / 'runs'}", "stage=augment", "shapes=folder")
    with pytest.raises(MissingData, match=r"set shapes\.root=FOLDER"):
        run_here(*words, f"shapes.root={tmp_path / 'none'}")
    assert not (tmp_path / "runs").exists()


def test_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    words = ("experiment=smoke", f"paths.cache={tmp_path}/cache", "stage=augment")
    with pytest.raises(OutputError, match=r"cannot be written \(Not a directory\).*paths\.runs="):
        run_here(*words, f"paths.runs={tmp_path}/file/runs")


# The first limit stops the results, the second already what the logger writes.
@pytest.mark.slow
@pytest.mark.parametrize("limit", [20_000, 1_500])
@pytest.mark.parametrize("logger", ["none", "csv"])
@pytest.mark.parametrize("stage", ["augment", "implicit"])
def test_full_disk(stage: str, logger: str, limit: int, smoke_copy: Path) -> None:
    """A limit on the size of files stands in for the disk."""
    folder = smoke_copy / "smoke" / "full" / stage
    shutil.rmtree(folder)
    few = ("workers.jobs=1", "recipe.implicit.epochs=4")
    words = (*smoke_words(smoke_copy), f"stage={stage}", *few, f"logger={logger}")
    done = subprocess.run(
        command(*words),
        cwd=ROOT,
        env=environment(),
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 2, done.stderr[-3000:]
    assert done.stderr.startswith("error: ")
    assert "cannot be written (File too large)" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (folder / "manifest.json").exists()
    left = [path for path in folder.rglob("*") if path.is_file()]
    results = [path for path in left if "logs" not in path.parts]
    assert all(path.stat().st_size < limit for path in results)
    assert not [path for path in left if path.name.startswith(".")]
    run_here(*words)
    assert (folder / "manifest.json").exists()


@pytest.mark.parametrize(
    ("below", "word"),
    [
        ("cache/prepared/00/a.npz", "paths.cache"),
        ("mine/meshes/a.ply", "prepare.out"),
        ("runs/smoke/full/augment/a.npz", "paths.runs"),
    ],
)
def test_a_full_disk_names_the_setting_of_its_place(
    below: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cfg = OmegaConf.create({"paths": {"cache": "cache"}, "prepare": {"out": f"{tmp_path}/mine"}})
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / below))
    told = rf"{below}: cannot be written \(No space .*; name another folder with {word}=FOLDER$"
    with pytest.raises(OutputError, match=told), _output_errors(cfg, tmp_path):
        raise full
    with (
        pytest.raises(OutputError, match=told),
        _output_errors(cfg, tmp_path),
        atomic_path(tmp_path / below),
    ):
        raise full


def test_ranks_behind_the_first_name_themselves(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("gensp.terminal._PATIENCE", 0.0)
    for rank in ("0", "3"):
        monkeypatch.setenv("RANK", rank)
        complain("of one")
        complain("of all", of_all=True)
    assert capsys.readouterr().err == "error: of one\nerror: of all\nerror: rank 3: of one\n"
