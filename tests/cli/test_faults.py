"""The remedies of the library, told in the words of the console script."""

import ast
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


def raised_texts() -> list[str]:
    """Every text of a raise statement of the package, what is filled in left out."""
    found = []
    for path in SOURCES.rglob("*.py"):
        raises = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Raise)]
        for node in (part for statement in raises for part in ast.walk(statement)):
            if isinstance(node, ast.JoinedStr):
                texts = (part.value for part in node.values if isinstance(part, ast.Constant))
                found.append("{}".join(map(str, texts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return found


@pytest.mark.parametrize("remedy", _REMEDIES)
def test_every_remedy_that_is_translated_is_raised(remedy: str) -> None:
    assert any(remedy in text for text in raised_texts())


def test_remedies_are_ordered() -> None:
    keys = list(_REMEDIES)
    for place, key in enumerate(keys):
        assert not [later for later in keys[place + 1 :] if key in later]
