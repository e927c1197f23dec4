from pkgutil import resolve_name

import numpy as np
import pytest
from layouts import write_parameterization

import gensp
from gensp.errors import DamagedFile, MissingStage, Unsupported
from gensp.files import read_json, write_text
from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.methods.familiarity import LIMITS
from gensp.methods.fitting import NoFit
from gensp.pretrained import FITS, FOLDER, LARGEST, digest, shipped
from gensp.pretrained.ship import entry_of, ship

NAMES = sorted(shipped())


def test_every_file_has_its_entry_and_is_small() -> None:
    assert {path.stem for path in FOLDER.glob("*.pt")} == set(NAMES)
    for name in NAMES:
        assert (FOLDER / f"{name}.pt").stat().st_size <= LARGEST
        assert shipped()[name].limits.keys() == LIMITS.keys()


def test_kinds_of_fits_are_classes() -> None:
    assert [resolve_name(FITS[kind]).__name__ for kind in ("none", "register", "guided")] == [
        "NoFit",
        "RegisterFit",
        "GuidedFit",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_a_model_of_the_package_maps_what_it_never_saw(name: str) -> None:
    ball = icosphere(3)
    egg = Mesh(ball.vertices * np.array([1.0, 1.3, 0.9]) + 0.1 * ball.vertices**2, ball.faces)
    map = gensp.load(name)(egg)
    assert map.certify().bijective
    assert map.diagnostics["far"]


def test_a_model_that_registers_keeps_how_it_does() -> None:
    kept = gensp.load("heads", register=True).fit
    assert kept.settings == gensp.load("heads").fit.settings
    assert isinstance(gensp.load("heads", register=False).fit, NoFit)


def test_a_changed_file_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    name = NAMES[0]
    (tmp_path / f"{name}.pt").write_bytes(b"other")
    monkeypatch.setattr("gensp.pretrained.FOLDER", tmp_path)
    with pytest.raises(Unsupported, match=r"SHA-256 .* required"):
        gensp.load(name)
    assert digest(tmp_path / f"{name}.pt") != shipped()[name].sha256


def test_shipping_copies_the_model_and_how_it_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    known, maps = shipped()[NAMES[0]], tmp_path / "maps"
    write_parameterization(maps)
    monkeypatch.setattr("gensp.pretrained.ship.FOLDER", tmp_path)
    monkeypatch.setattr("gensp.pretrained.ship.TABLE", tmp_path / "models.json")
    ship("copy", maps, known.path)
    entry = read_json(tmp_path / "models.json")["copy"]
    assert entry["sha256"] == known.sha256 == digest(tmp_path / "copy.pt")
    assert entry["method"] == {"level": 5, "own": 0.5}
    assert entry["fit"] == {"kind": "register", "level": 4}
    assert entry["refine"] == {"pull": 7.0, "energy": "sigma"}
    assert entry["limits"] == LIMITS


def test_a_folder_that_is_no_parameterization_is_refused(tmp_path) -> None:
    with pytest.raises(MissingStage, match=r"stage=parameterize"):
        entry_of(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "method: 3",
        "[]",
        "",
        "method: {name: gensp, object: 1}",
        "!!python/object:os.system {}",
    ],
)
def test_a_damaged_configuration_is_one_line(tmp_path, text: str) -> None:
    write_text(tmp_path / "config.yaml", text)
    write_text(tmp_path / "manifest.json", "{}")
    with pytest.raises(DamagedFile, match=r"config\.yaml: is damaged \(.*required; restore"):
        entry_of(tmp_path)


def test_an_unknown_model_is_told_which_there_are():
    with pytest.raises(MissingStage, match=r"horses.*heads, humans, quadrupeds"):
        gensp.load("horses")
