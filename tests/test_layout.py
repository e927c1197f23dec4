"""The files of many items lie in many folders: where, who finds them, what stays the same."""

import re
from pathlib import Path
from typing import Any

import pytest
from commands import STAGES, run_here, smoke_words
from compare import load, results

from gensp import layout
from gensp.cli import app
from gensp.compute import Row, row_path, run_items, stored_rows
from gensp.data.items import item_path
from gensp.errors import DamagedFile
from gensp.files import write_text
from gensp.layout import LAYOUT, digits_for, item_files, item_folder, keyed_path, lay_out
from gensp.runs import Run
from gensp.sharing import Workers
from gensp.tasks.correspond import edge_path
from gensp.tasks.evaluate import map_path, pairs_path
from gensp.tasks.joining import alternative_path
from gensp.tasks.pairing import pair_path
from gensp.tasks.prepare import prepared_path

ITEMS = [f"shape{k}" for k in range(8)] + ["c/d", "e@3"]


def named(item: str) -> Row:
    return {"id": item}


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than three items are many."""
    monkeypatch.setattr(layout, "MOST", 3)


def test_folders_begin_the_checksum_of_the_id(tmp_path: Path) -> None:
    assert item_folder(tmp_path, "maps", "abc") == tmp_path / "maps"
    lay_out(tmp_path, 20_000)
    # SHA-256 of "abc", FIPS 180-4 example: ba7816bf...
    assert item_folder(tmp_path, "maps", "abc") == tmp_path / "maps" / "ba"
    assert item_folder(tmp_path, ".", "abc") == tmp_path / "ba"


def test_no_folder_of_a_million_items_is_large() -> None:
    assert [digits_for(n) for n in (4097, 16_384, 16_385, 10**6)] == [1, 1, 2, 3]
    for items in (4097, 10**5, 10**6, 10**7):
        assert items / 16 ** digits_for(items) <= 1024


def test_few_items_lie_side_by_side(tmp_path: Path) -> None:
    list(run_items(named, ITEMS, tmp_path, Workers(1)))
    assert not (tmp_path / LAYOUT).exists()
    assert (tmp_path / "rows" / "shape0.json").is_file()


@pytest.mark.parametrize("jobs", [1, 2])
def test_rows_of_many_folders_are_those_of_one(few: None, tmp_path: Path, jobs: int) -> None:
    list(run_items(named, ITEMS, tmp_path / "many", Workers(jobs)))
    assert len({path.parent for path in item_files(tmp_path / "many", "rows", ".json")}) > 3
    write_text(tmp_path / "one" / "rows" / "shape0.json", '{"id": "shape0"}')
    list(run_items(named, ITEMS, tmp_path / "one", Workers(1)))
    assert not (tmp_path / "one" / LAYOUT).exists(), "a run that was begun goes on as it was"
    assert stored_rows(tmp_path / "many") == stored_rows(tmp_path / "one")


def test_what_is_missing_in_many_folders_is_done_again(few: None, tmp_path: Path) -> None:
    list(run_items(named, ITEMS, tmp_path, Workers(1)))
    before = {path: path.stat().st_mtime_ns for path in item_files(tmp_path, "rows", ".json")}
    row_path(tmp_path, "c/d").unlink()
    # One item is not many, but where it lies was decided.
    list(run_items(named, ["c/d"], tmp_path, Workers(1)))
    after = {path: path.stat().st_mtime_ns for path in item_files(tmp_path, "rows", ".json")}
    assert before.keys() == after.keys()
    assert {path for path in before if before[path] != after[path]} == {row_path(tmp_path, "c/d")}


PLACES = {
    "meshes": item_path,
    "maps": map_path,
    "pairs": pairs_path,
    "corr": lambda folder, id: prepared_path(folder, "corr", id),
    "edges": edge_path,
    "edges of pairs": lambda folder, id: pair_path(folder, id, "b").parent,
    "alternatives": lambda folder, id: alternative_path(folder, "b", id).parents[1],
    "rows": row_path,
}


@pytest.mark.parametrize("kind", PLACES)
def test_every_kind_of_file_lies_where_the_layout_says(kind: str, tmp_path: Path) -> None:
    flat = PLACES[kind](tmp_path, "abc")
    for folder in (tmp_path, tmp_path / "alternatives"):
        write_text(folder / LAYOUT, '{"digits": 2}')
    assert PLACES[kind](tmp_path, "abc") == flat.parent / "ba" / flat.name


@pytest.mark.parametrize("text", ["{}", "[]", '{"digits": 0}', '{"digits": "2"}', "{"])
def test_a_damaged_layout_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / LAYOUT).write_text(text)
    with pytest.raises(DamagedFile, match=r"layout\.json: is damaged") as caught:
        item_folder(tmp_path, "maps", "a")
    assert "\n" not in str(caught.value)


def test_a_cache_finds_what_it_kept_before_there_were_folders(tmp_path: Path) -> None:
    assert keyed_path(tmp_path, "3fa1", ".npz") == tmp_path / "3f" / "3fa1.npz"
    (tmp_path / "3fa1.npz").touch()
    assert keyed_path(tmp_path, "3fa1", ".npz") == tmp_path / "3fa1.npz"


def gathered(folder: Path) -> dict[str, Any]:
    """The results of a stage by name, without the folders that the layout has put them in."""
    found = {}
    for name in results(folder):
        *above, last = Path(name).parts
        places = [
            part
            for part, outer in zip(above, ["", *above], strict=False)
            if outer == "rounds" or not re.fullmatch("[0-9a-f]{1,2}", part)
        ]
        found["/".join([*places, last])] = load(folder / name)
    return {name: content for name, content in found.items() if Path(name).name != LAYOUT}


def unlike(ours: Path, theirs: Path) -> list[str]:
    first, second = gathered(ours), gathered(theirs)
    return sorted(
        name for name in {*first, *second} if name not in first or first[name] != second.get(name)
    )


@pytest.mark.slow
def test_all_stages_give_the_same_from_many_folders(
    few: None,
    smoke: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = (*smoke_words(tmp_path), "workers.jobs=1")
    run_here(*words)
    require_alike(tmp_path, smoke)
    require_resumed(tmp_path, words)
    for command in ("show", "list"):
        monkeypatch.setattr("sys.argv", ["gensp", "runs", command, str(tmp_path / "smoke")])
        with pytest.raises(SystemExit) as ended:
            app()
        assert not ended.value.code
        assert len(capsys.readouterr().out.splitlines()) > len(STAGES)


def require_alike(ours: Path, theirs: Path) -> None:
    """All stages of two smoke runs have the same results, item by item."""
    for stage in STAGES:
        folder = ours / "smoke" / "full" / stage
        assert unlike(folder, theirs / "smoke" / "full" / stage) == []
    assert len(list((ours / "smoke/full/parameterize/maps").glob("?/*.npz"))) == 6


def require_resumed(runs: Path, words: tuple[str, ...]) -> None:
    """A stage without its seal and two of its rows does these two items again, with equal maps."""
    folder = runs / "smoke" / "full" / "parameterize"
    outputs, rows = Run(folder).outputs, item_files(folder, "rows", ".json")
    before = {path: path.stat().st_mtime_ns for path in rows}
    for path in (*rows[:2], folder / "manifest.json"):
        path.unlink()
    run_here(*words, "stage=parameterize")
    assert Run(folder).outputs == outputs
    assert [path for path in rows if path.stat().st_mtime_ns != before[path]] == rows[:2]
