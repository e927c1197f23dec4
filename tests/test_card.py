"""The data card tells what is in a collection."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import ROOT
from layouts import ring
from PIL import Image

from gensp.card import CARD, PICTURE, write_card
from gensp.errors import BadMesh, MissingData
from gensp.geometry.mesh import Mesh, save_mesh


def lines(folder: Path) -> list[str]:
    return (folder / CARD).read_text(encoding="utf-8").splitlines()


def test_numbers_are_those_of_the_meshes(tmp_path: Path, bumpy: Mesh, dumbbell: Mesh) -> None:
    save_mesh(bumpy, tmp_path / "a.ply")
    save_mesh(Mesh(dumbbell.vertices, dumbbell.faces[:-1]), tmp_path / "b.ply")
    (tmp_path / "manifest.csv").write_text(
        "file,split,category,licence,source\n"
        "a.ply,train,stone,CC0,here\nb.ply,test,stone,CC-BY,there\n"
    )
    write_card(tmp_path, name="two")
    page = lines(tmp_path)
    assert page[0] == "# Data card: two"
    assert "| meshes | 2 (train 1, test 1) |" in page
    assert "| vertices | 642 to 642, median 642 |" in page
    assert "| faces | 1,279 to 1,280, median 1,280 |" in page
    assert "| genus | 0: 1 meshes, not closed: 1 meshes |" in page
    assert "| stone | 1 | 0 | 1 |" in page
    assert "| CC0 | here | 1 |" in page
    assert "| dense ground truth | none |" in page


@pytest.mark.parametrize("name", ["heads", "quadrupeds"])
def test_embedded_cards_are_those_that_the_command_writes(name: str, tmp_path: Path) -> None:
    paths = write_card(ROOT / "data" / name, out=tmp_path, shown=1)
    assert paths == [tmp_path / CARD, tmp_path / PICTURE]
    assert lines(tmp_path) == lines(ROOT / "data" / name)
    assert (ROOT / "data" / name / PICTURE).stat().st_size < 200_000
    with open(ROOT / "data" / name / "manifest.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert f"| meshes | {len(rows)} (" in (tmp_path / CARD).read_text()


def test_genus_is_counted_over_all_parts(tmp_path: Path, bumpy: Mesh) -> None:
    for name, parts in {"ring": [ring()], "both": [ring(), bumpy]}.items():
        vertices = np.concatenate([part.vertices + 9 * k for k, part in enumerate(parts)])
        first = [0, len(parts[0].vertices)]
        faces = np.concatenate([part.faces + first[k] for k, part in enumerate(parts)])
        save_mesh(Mesh(vertices, faces), tmp_path / f"{name}.ply")
    write_card(tmp_path)
    assert "| genus | 1: 2 meshes |" in lines(tmp_path)


def test_so_many_meshes_are_drawn(tmp_path: Path, bumpy: Mesh) -> None:
    for number in range(9):
        save_mesh(bumpy, tmp_path / f"m{number}.ply")
    write_card(tmp_path, shown=3)
    few = Image.open(tmp_path / PICTURE).size
    write_card(tmp_path, shown=9)
    many = Image.open(tmp_path / PICTURE).size
    assert many[0] == 2 * few[0]  # six columns instead of three
    assert many[1] == 2 * few[1]  # two rows instead of one


def test_a_folder_without_meshes_and_a_damaged_mesh_are_told(tmp_path: Path) -> None:
    with pytest.raises(MissingData, match=r"nowhere: is not a folder"):
        write_card(tmp_path / "nowhere")
    with pytest.raises(MissingData, match=r"holds no mesh"):
        write_card(tmp_path)
    shutil.copy(ROOT / "data" / "heads" / "manifest.csv", tmp_path / "x.ply")
    with pytest.raises(BadMesh, match=r"x\.ply: cannot be read"):
        write_card(tmp_path)
    assert not (tmp_path / CARD).exists()
