"""Models that come with the package, and how each of them is meant to be used."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from gensp.errors import Unsupported
from gensp.files import read_json
from gensp.methods.refinement import CertifiedRefinement

FOLDER = Path(__file__).parent
TABLE = FOLDER / "models.json"
LARGEST = 8_000_000  # bytes of one file
# Kinds of fits and where their classes are: they need torch, and a list of names does not.
FITS = {
    "none": "gensp.methods.fitting.NoFit",
    "register": "gensp.methods.fitting.RegisterFit",
    "guided": "gensp.methods.guided_fitting.GuidedFit",
}


@dataclass(frozen=True)
class Shipped:
    """One model of the package.

    Attributes
    ----------
    name, sha256
        Its name, and the digest of its file `<name>.pt`.
    method
        Numbers of `gensp.GenSP`: level, own.
    fit
        Kind of the fit (a key of `FITS`) and its arguments.
    refine
        Arguments of `CertifiedRefinement`.
    limits
        Shapes whose gap or stretch is larger are far from what the model knows.
    """

    name: str
    sha256: str
    method: Mapping[str, Any]
    fit: Mapping[str, Any]
    refine: Mapping[str, Any]
    limits: Mapping[str, float]

    @property
    def path(self) -> Path:
        """The file, after its digest was compared.

        Raises
        ------
        Unsupported
            The file is not the one that the table describes.
        """
        file = FOLDER / f"{self.name}.pt"
        found = digest(file) if file.is_file() else "no file"
        if found != self.sha256:
            raise Unsupported(
                f"{file}: has SHA-256 {found}; {self.sha256} is required; install gensp again"
            )
        return file

    def settings(self) -> dict[str, Any]:
        """Arguments of `gensp.GenSP.load` beside the path."""
        arguments = {key: value for key, value in self.fit.items() if key != "kind"}
        return {
            **self.method,
            "limits": self.limits,
            "fit": resolve_name(FITS[self.fit["kind"]])(**arguments),
            "refine": CertifiedRefinement(**self.refine),
        }


def shipped() -> dict[str, Shipped]:
    """All models of the package, by name."""
    return {name: Shipped(name=name, **entry) for name, entry in read_json(TABLE).items()}


def digest(file: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()
