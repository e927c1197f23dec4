"""Take a trained model into the package: `python -m gensp.pretrained.ship NAME MAPS`.

MAPS is a finished folder of stage parameterize: its configuration tells how the model is used.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

from gensp.errors import DamagedFile, GenSPError, MissingStage, Unsupported
from gensp.files import atomic_path, read_json, read_yaml, write_json
from gensp.geometry.spherical_energy import ENERGIES
from gensp.methods.familiarity import LIMITS
from gensp.methods.refinement import CertifiedRefinement
from gensp.models import load_model
from gensp.pretrained import FITS, FOLDER, LARGEST, TABLE, Shipped, digest

_KINDS = {target: kind for kind, target in FITS.items()}
_CERTIFIED = f"{CertifiedRefinement.__module__}.{CertifiedRefinement.__name__}"
_REFINE = ("pull", "bregman", "energy", "floor", "max_iterations", "tolerance", "crowding")


def entry_of(maps: Path) -> dict[str, Any]:
    """How a finished parameterization used its model.

    Raises
    ------
    MissingStage
        The folder holds no configuration.
    DamagedFile
        It is no configuration of a parameterization.
    Unsupported
        The maps are not of a model.
    """
    file = maps / "config.yaml"
    if not file.is_file() or not (maps / "manifest.json").is_file():
        raise MissingStage(f"{maps}: a finished folder of stage=parameterize is required")
    try:
        return _entry(maps, read_yaml(file))
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise DamagedFile(
            f"{file}: is damaged ({type(error).__name__}: {str(error)[:80]}); the configuration "
            "of a parameterization by method=gensp is required; restore it, or make the stage "
            "anew with force=true"
        ) from error


def _entry(maps: Path, config: Any) -> dict[str, Any]:
    if config["method"]["name"] != "gensp":
        raise Unsupported(f"{maps}: method=gensp is required; found {config['method']['name']}")
    fit = dict(config["method"]["object"]["fit"])
    refine = dict(config["refine"]["object"])
    if refine["_target_"] != _CERTIFIED:
        raise Unsupported(f"{maps}: refine=certify is required, which models of the package use")
    entry = {
        "method": {"level": config["method"]["object"]["level"], "own": config["fit"]["own"]},
        "fit": {"kind": _KINDS[fit.pop("_target_")], **fit},
        "refine": {key: refine[key] for key in _REFINE if key in refine},
    }
    numbers = {**entry["method"], **entry["refine"], "energy": 0}
    for key, value in numbers.items():
        if not isinstance(value, int | float):
            raise TypeError(f"{key} is {value!r}, no number")
    if entry["refine"].get("energy", "sigma") not in ENERGIES:
        raise ValueError(f"there is no energy {entry['refine']['energy']!r}")
    # Whatever a fit or a refinement does not take is told here, not when the model is loaded.
    Shipped(name="", sha256="", limits=LIMITS, **entry).settings()
    return entry


def ship(name: str, maps: Path, model: Path) -> Path:
    """Copy a model.pt and write its entry.

    Its limits are those of other models until `benchmarks/familiarity.py` has measured them.

    Raises
    ------
    Unsupported
        The file is too large.
    """
    if "atlas" not in load_model(model):
        raise Unsupported(f"{model}: knows no shapes; a model.pt of stage=finetune is required")
    size = model.stat().st_size
    if size > LARGEST:
        raise Unsupported(
            f"{model}: has {size:,} bytes; at most {LARGEST:,} are required; keep fewer shapes"
        )
    use = entry_of(maps)
    target = FOLDER / f"{name}.pt"
    with atomic_path(target) as temporary:
        temporary.write_bytes(model.read_bytes())
    table = read_json(TABLE) if TABLE.is_file() else {}
    entry = {"sha256": digest(target), **use, "limits": dict(LIMITS)}
    write_json(TABLE, dict(sorted({**table, name: entry}.items())))
    return target


def main() -> int:
    """Read the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("maps", type=Path, help="finished folder of stage parameterize")
    parser.add_argument(
        "--model", type=Path, help="model.pt (default: that of ../../full/finetune)"
    )
    chosen = parser.parse_args()
    model = chosen.model or chosen.maps.parent.parent / "full" / "finetune" / "model.pt"
    try:
        sys.stdout.write(f"{ship(chosen.name, chosen.maps, model)}\n")
    except GenSPError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
