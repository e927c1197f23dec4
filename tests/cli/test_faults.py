"""The remedies of the library, told in the words of the console script."""

from pathlib import Path

import pytest

from gensp.cli.faults import _REMEDIES, fault_line
from gensp.errors import DegenerateMesh
from gensp.geometry.mesh import Mesh, require_genus_zero

SOURCES = Path(__file__).parents[2] / "gensp"


def test_no_remedy_eats_a_longer_one(bumpy: Mesh) -> None:
    with pytest.raises(DegenerateMesh) as caught:
        require_genus_zero(bumpy, max_faces=10)
    line = fault_line(caught.value)
    assert line is not None
    assert line.endswith("simplify it (gensp repair --remesh does)")


def test_remedies_are_ordered() -> None:
    keys = list(_REMEDIES)
    for place, key in enumerate(keys):
        assert not [later for later in keys[place + 1 :] if key in later]
