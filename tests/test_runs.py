"""Run folders: the restart table row by row, predecessors, seals."""

import json
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

from gensp.checksums import FILES, listing
from gensp.errors import MissingStage, OutputError, StaleRun
from gensp.files import write_json
from gensp.machine import environment
from gensp.restarts import Progress, begin, clear, differences, restart
from gensp.runs import CHECKPOINT, MANIFEST, Run, Runs, seal

SETTINGS = {"stage": {"name": "implicit", "rate": 0.1, "sizes": (1, 2)}, "seed": 0}
OTHER = {"stage": {"name": "implicit", "rate": 0.2, "sizes": (1, 2)}, "seed": 0}


def sealed(folder: Path, settings: dict = SETTINGS) -> Run:
    begin(folder, settings)
    return seal(folder, stage="implicit", settings=settings, metrics={"loss": 0.5}, facts={})


def test_restart_with_nothing_there(tmp_path: Path) -> None:
    assert restart(tmp_path / "new", SETTINGS) is Progress.NOTHING


@pytest.mark.parametrize("left", [str(CHECKPOINT), "rows/a.json", "settings.json"])
def test_restart_of_an_unfinished_run(tmp_path: Path, left: str) -> None:
    begin(tmp_path, SETTINGS)
    path = tmp_path / left
    path.parent.mkdir(exist_ok=True)
    path.touch()
    assert restart(tmp_path, SETTINGS) is Progress.SOME
    with pytest.raises(StaleRun, match=r"stage\.rate: 0\.1 → 0\.2"):
        restart(tmp_path, OTHER)


def test_restart_of_a_finished_run(tmp_path: Path) -> None:
    sealed(tmp_path)
    assert restart(tmp_path, SETTINGS) is Progress.ALL
    with pytest.raises(StaleRun, match=r"force=true .* name=NEW"):
        restart(tmp_path, OTHER)


def test_forced_run_starts_from_nothing(tmp_path: Path) -> None:
    sealed(tmp_path / "run")
    clear(tmp_path / "run")
    assert restart(tmp_path / "run", OTHER) is Progress.NOTHING


def test_manifest_tells_what_was_made(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a.txt").write_text("abc")
    run = sealed(tmp_path)
    files = {entry.file: entry for entry in run.files()}
    assert files["maps/a.txt"].bytes == 3
    # SHA-256 of "abc", FIPS 180-4 example.
    assert files["maps/a.txt"].sha256.startswith("ba7816bf8f01cfea")
    assert not {MANIFEST, FILES} & files.keys()
    assert run.headline == 0.5
    assert {"versions", "revision", "machine", "peak_memory_gib"} <= run.manifest.keys()


def test_digest_depends_on_settings_alone(tmp_path: Path) -> None:
    first, second = sealed(tmp_path / "a"), sealed(tmp_path / "b")
    (tmp_path / "b" / "more.txt").touch()
    assert first.digest == second.digest
    assert sealed(tmp_path / "c", OTHER).digest != first.digest


def made(folder: Path, files: dict[str, str], settings: dict = SETTINGS) -> Run:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return sealed(folder, settings)


def test_equal_results_have_equal_digests_however_they_were_made(tmp_path: Path) -> None:
    first = made(tmp_path / "a", {"meshes/x.npz": "x", "rows/x.json": "1 s", "flows.csv": "1 s"})
    again = made(
        tmp_path / "b",
        {"meshes/x.npz": "x", "more/rows/x.json": "2 s", "flows.csv": "2 s", "logs/hparams": "2"},
        OTHER,
    )
    assert first.outputs == again.outputs
    changed = made(tmp_path / "c", {"meshes/x.npz": "y"})
    renamed = made(tmp_path / "d", {"meshes/y.npz": "x"})
    assert len({first.outputs, changed.outputs, renamed.outputs}) == 3


@pytest.mark.parametrize("finished", [True, False])
def test_other_results_of_a_stage_before_make_a_run_stale(tmp_path: Path, finished: bool) -> None:
    settings = {**SETTINGS, "inputs": {"augment": "a", "implicit": "b"}}
    (sealed if finished else begin)(tmp_path, settings)
    assert restart(tmp_path, settings) is (Progress.ALL if finished else Progress.SOME)
    with pytest.raises(StaleRun) as caught:
        restart(tmp_path, {**settings, "inputs": {"augment": "a", "implicit": "c"}})
    assert str(caught.value) == (
        f"{tmp_path}: made from other results of stage implicit than there are now; a stage and "
        "what it reads must belong together; make it anew from them with stage=implicit "
        "force=true, or name=NEW to keep both"
    )


def test_failed_seal_leaves_no_manifest(tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        seal(tmp_path, stage="x", settings=SETTINGS, metrics={}, facts={"bad": object()})
    assert not Run(tmp_path).complete
    assert list(listing(tmp_path)) == []


def test_missing_predecessor_names_the_command(tmp_path: Path) -> None:
    runs = Runs(tmp_path, "toy", "full", command="python train.py experiment=toy")
    with pytest.raises(MissingStage) as caught:
        runs.open("implicit", needed_by="correspond")
    assert str(caught.value) == (
        f"'correspond' needs 'implicit', but {tmp_path}/toy/full/implicit has no manifest.json; "
        "run: python train.py experiment=toy stage=implicit"
    )


def test_shared_stage_is_found_in_the_other_variant(tmp_path: Path) -> None:
    sealed(tmp_path / "toy" / "full" / "implicit")
    runs = Runs(tmp_path, "toy", "no_gp", shares={"implicit": "full"})
    assert runs.open("implicit", needed_by="correspond").folder == tmp_path / "toy/full/implicit"
    assert runs.folder("correspond") == tmp_path / "toy" / "no_gp" / "correspond"
    assert Runs(tmp_path, "toy", "no_gp").find("implicit") is None


def test_folder_given_by_hand_wins(tmp_path: Path) -> None:
    sealed(tmp_path / "toy" / "full" / "implicit")
    other = sealed(tmp_path / "elsewhere")
    runs = Runs(tmp_path, "toy", "full", inputs={"implicit": str(other.folder), "augment": None})
    assert runs.open("implicit", needed_by="correspond").folder == other.folder


def test_differences_name_nested_keys() -> None:
    old = {"a": {"b": 1, "c": [1, 2]}, "gone": True}
    new = {"a": {"b": 1, "c": [1, 3]}, "come": "x"}
    assert differences(old, new) == [
        "a.c: [1, 2] → [1, 3]",
        "gone: True → nothing",
        "come: nothing → x",
    ]


def test_unwritable_place_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"paths\.runs=FOLDER") as caught:
        begin(tmp_path / "file" / "run", SETTINGS)
    assert "\n" not in str(caught.value)


def test_settings_survive_json(tmp_path: Path) -> None:
    begin(tmp_path, SETTINGS)
    stored = json.loads((tmp_path / "settings.json").read_text())
    assert differences(stored["settings"], json.loads(json.dumps(SETTINGS))) == []
    write_json(tmp_path / "settings.json", stored)
    assert restart(tmp_path, SETTINGS) is Progress.SOME


def test_the_revision_is_that_of_the_repository_that_holds_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not of one around them: a package may be installed within somebody's repository."""

    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b")
        command = ["git", "-C", str(tmp_path), *identity, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    source = tmp_path / "site" / "gensp" / "machine.py"
    source.parent.mkdir(parents=True)
    source.touch()
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "another's")
    monkeypatch.setattr("gensp.machine.__file__", str(source))
    assert environment()["revision"] == version("gensp")
    git("add", ".")
    git("commit", "-q", "-m", "the sources")
    assert environment()["revision"] == git("rev-parse", "--short", "HEAD")
