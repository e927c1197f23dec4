import time

import numpy as np
import pytest

import gensp
from gensp.errors import MissingStage, Unsupported
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.pretrained import FOLDER, LARGEST, digest, shipped
from gensp.pretrained.ship import entry_of

NAMES = sorted(shipped())


def test_every_file_has_its_entry_and_is_small() -> None:
    assert {path.stem for path in FOLDER.glob("*.pt")} == set(NAMES)
    for name in NAMES:
        assert (FOLDER / f"{name}.pt").stat().st_size <= LARGEST


@pytest.mark.parametrize("name", NAMES)
def test_a_model_of_the_package_maps_what_it_never_saw(name: str) -> None:
    ball = icosphere(3)
    egg = Mesh(ball.vertices * np.array([1.0, 1.3, 0.9]) + 0.1 * ball.vertices**2, ball.faces)
    began = time.perf_counter()
    map = gensp.load(name)(egg)
    assert map.certify().bijective
    assert map.diagnostics["novelty"] > shipped()[name].novel
    assert time.perf_counter() - began < 60


def test_a_changed_file_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    name = NAMES[0]
    (tmp_path / f"{name}.pt").write_bytes(b"other")
    monkeypatch.setattr("gensp.pretrained.FOLDER", tmp_path)
    with pytest.raises(Unsupported, match=r"SHA-256 .* required"):
        gensp.load(name)
    assert digest(tmp_path / f"{name}.pt") != shipped()[name].sha256


def test_a_folder_that_is_no_parameterization_is_refused(tmp_path) -> None:
    with pytest.raises(MissingStage, match=r"stage=parameterize"):
        entry_of(tmp_path)
