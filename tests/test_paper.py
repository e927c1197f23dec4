"""docs/paper.md against the code: functions exist and name their equations, keys exist."""

import importlib
import inspect
import re
from pathlib import Path

import pytest
from omegaconf import OmegaConf

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")


def table(title: str) -> list[list[str]]:
    """Rows of the table below a heading, without its head."""
    section = PAGE.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows[2:]]


def names(text: str) -> list[str]:
    return re.findall(r"`(gensp\.[\w.]+)`", text)


def resolve(name: str) -> object:
    module, attribute = name.rsplit(".", 1)
    return getattr(importlib.import_module(module), attribute)


def equations(text: str) -> set[str]:
    """Numbers in "Eq. 7", "Eqs. 5 to 8", "Eq. 7–8", "Eqs. 11 and 12"."""
    found: set[str] = set()
    for run in re.findall(r"Eqs?\. (\d+(?:(?:–|, | to | and )\d+)*)", text):
        numbers = [int(number) for number in re.findall(r"\d+", run)]
        spans = "–" in run or " to " in run
        found |= {str(n) for n in (range(numbers[0], numbers[-1] + 1) if spans else numbers)}
    return found


def sections(text: str) -> set[str]:
    """Sections and appendices, as "3.3" and "B.4"; a range names its ends."""
    return set(re.findall(r"(?:§|–|[Aa]pp(?:endix|\.) )(\d\.\d|[A-C](?:\.\d)?)", text))


LABELLED = [(row[0], name) for row in table("Equations") for name in names(row[2])]


def test_the_table_has_all_twelve_equations() -> None:
    labels = {label for label, _ in LABELLED}
    assert {str(n) for n in range(1, 13)} <= labels
    assert all(names(row[2]) for row in table("Equations"))


@pytest.mark.parametrize(("label", "name"), LABELLED)
def test_function_names_its_equation(label: str, name: str) -> None:
    found = resolve(name)
    assert callable(found)
    own = inspect.getdoc(found) or ""
    if label.isdigit():
        assert label in equations(own), f"{name}: {own.splitlines()[0]}"
    else:
        around = own + (inspect.getmodule(found).__doc__ or "")
        assert sections(label) & sections(around), f"{name}: {around.splitlines()[0]}"


@pytest.mark.parametrize("name", sorted(set(names(PAGE))))
def test_every_name_on_the_page_resolves(name: str) -> None:
    assert callable(resolve(name))


@pytest.mark.parametrize("key", sorted(set(re.findall(r"`recipe\.([\w.]+)`", PAGE))))
def test_every_key_on_the_page_is_in_the_recipe(key: str) -> None:
    recipe = OmegaConf.load(ROOT / "conf" / "recipe" / "paper.yaml")
    assert OmegaConf.select(recipe, key, throw_on_missing=True) is not None


def test_parser_of_equation_names() -> None:
    assert equations("Eq. 7 and Eqs. 10 to 12") == {"7", "10", "11", "12"}
    assert equations("(Eqs. 11 and 3)") == {"3", "11"}
    assert sections("paper §4.3–4.4, App. B.3; Appendix A") == {"4.3", "4.4", "B.3", "A"}
