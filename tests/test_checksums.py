"""The list of a stage's files: order, seal, damages, memory."""

import csv
import os
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from gensp.catalogue import find_runs
from gensp.checksums import (
    FILES,
    MANIFEST,
    Listed,
    digest_of,
    file_hash,
    inline,
    listed,
    listing,
    require_intact,
    write_list,
)
from gensp.errors import DamagedFile
from gensp.files import content_hash, read_json, write_json
from gensp.restarts import begin
from gensp.runs import Run, seal

SETTINGS = {"stage": {"name": "augment"}, "seed": 0}
NAMES = ("a.csv", "a/b.npz", "a/c/d", "a-b/c", "ab", "é,\n'\"x", "rows/3f/x.json", "Z")


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A sealed stage with files of all names."""
    for name in NAMES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name, encoding="utf-8")
    begin(tmp_path, SETTINGS)
    return seal(tmp_path, stage="augment", settings=SETTINGS, metrics={"x": 1}, facts={})


def test_the_list_is_ordered_and_comes_back(run: Run) -> None:
    names = [entry.file for entry in run.files()]
    assert names == sorted([*NAMES, "settings.json"])
    assert list(run.files()) == list(listing(run.folder))
    assert write_list(run.folder) == run.manifest["files"], "written twice it is the same"


def test_the_seal_tells_count_and_bytes(run: Run) -> None:
    told = run.manifest["files"]
    assert told["count"] == len(NAMES) + 1
    assert told["bytes"] == sum((run.folder / entry.file).stat().st_size for entry in run.files())
    with open(run.folder / FILES, encoding="utf-8", newline="") as file:
        rows = {row["file"]: row for row in csv.DictReader(file)}
    # SHA-256 of "ab", from coreutils.
    assert rows["ab"]["sha256"].startswith("fb8e20fc2e4c3f24")
    assert rows["ab"]["bytes"] == "2"


def test_a_name_that_is_no_text_is_listed(tmp_path: Path) -> None:
    name = os.fsdecode(b"\xff.npz")
    try:
        (tmp_path / name).write_text("x")
    except OSError:
        pytest.skip("the file system takes no such names")
    sealed = write_list(tmp_path)
    assert [entry.file for entry in listed(tmp_path, sealed)] == [name]
    require_intact(tmp_path, listed(tmp_path, sealed), "augment")


def test_the_digest_line_by_line_is_that_of_the_whole_table(run: Run) -> None:
    table = {entry.file: entry.sha256 for entry in run.files()}
    assert digest_of(run.files()) == content_hash(table)


def test_a_list_within_the_manifest_tells_the_same(run: Run) -> None:
    outputs, entry = run.outputs, find_runs(run.folder)[0]
    manifest = read_json(run.folder / MANIFEST)
    write_json(run.folder / MANIFEST, {**manifest, "files": inline(run.files())})
    (run.folder / FILES).unlink()
    before, (found,) = Run(run.folder), find_runs(run.folder)
    assert before.outputs == outputs
    assert (found.files, found.size) == (entry.files, entry.size)


def damaged(path: Path, how: str) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    if how == "missing":
        path.unlink()
    elif how == "truncated":
        path.write_bytes(b"".join(lines[:-1]))
    elif how == "cut":
        path.write_bytes(b"".join(lines)[:-7])
    elif how == "longer":
        path.write_bytes(b"".join([*lines, lines[-1]]))
    elif how == "another":
        path.write_bytes(b"".join(lines).replace(b"ab,2", b"ab,3"))
    else:
        path.write_bytes(b"")


@pytest.mark.parametrize("how", ["missing", "truncated", "cut", "longer", "another", "empty"])
def test_a_damaged_list_is_told_before_anything_is_read_of_it(run: Run, how: str) -> None:
    damaged(run.folder / FILES, how)
    found = "is missing" if how == "missing" else "was changed since it was written"
    for read in (lambda: run.files(), lambda: Run(run.folder).outputs):
        with pytest.raises(DamagedFile, match=rf"files\.csv: {found}.* force=true") as caught:
            read()
        assert "\n" not in str(caught.value)


UNTOLD = r"manifest\.json: is damaged \(does not tell of its files\); .* force=true$"
OTHER = r"files\.csv: was changed since it was written; .* force=true$"


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, UNTOLD),
        ({"count": 3}, UNTOLD),
        ({"a": {"bytes": 1}}, UNTOLD),
        ({"sha256": "0", "count": "many", "bytes": 0}, OTHER),
    ],
)
def test_a_manifest_that_does_not_tell_of_its_files_is_told(
    run: Run, files: Any, told: str
) -> None:
    manifest = read_json(run.folder / MANIFEST)
    write_json(run.folder / MANIFEST, {**manifest, "files": files})
    with pytest.raises(DamagedFile, match=told):
        _ = Run(run.folder).outputs


def test_a_long_list_takes_no_memory(tmp_path: Path) -> None:
    peaks = []
    for count in (2_000, 20_000):
        with open(tmp_path / FILES, "w") as file:
            file.write("file,bytes,sha256\n")
            file.writelines(f"maps/{k:07d}.npz,1,{'0' * 64}\n" for k in range(count))
        sealed = {"count": count, "bytes": count, "sha256": file_hash(tmp_path / FILES)}
        tracemalloc.start()
        digest_of(listed(tmp_path, sealed))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 2**16
    assert isinstance(next(listed(tmp_path, sealed)), Listed)
