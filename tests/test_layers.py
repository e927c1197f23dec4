"""What may import what: read from the sources, so that the table in the design stays true."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "gensp"

CORE = {"errors", "files"}
# Layer → what it may import of ours, itself left out. A module with a row of its own is no part of
# its package's row.
ALLOWED = {
    "errors": set(),
    "files": {"errors"},
    "layout": {"errors", "files"},
    "compiled": set(),
    "geometry": CORE | {"compiled"},
    "models": CORE | {"geometry"},
    "losses": CORE | {"geometry"},
    "sharing": CORE,
    "compute": CORE | {"layout", "sharing", "machine"},
    "data": CORE | {"layout", "geometry", "compute", "sharing", "checksums"},
    "methods": CORE | {"geometry", "models", "data.clouds"},
    "pretrained": CORE | {"geometry", "methods", "models"},
    "machine": set(),
    "checksums": CORE,
    "runs": CORE | {"machine", "checksums"},
    "columns": set(),
    "tables": CORE | {"columns"},
    "pictures": CORE | {"layout", "geometry", "columns", "tables"},
}
ALLOWED["restarts"] = CORE | {"runs", "checksums"}
ALLOWED["clusters"] = CORE | {"sharing"}
ALLOWED["job_arrays"] = CORE | {"sharing", "clusters"}
ALLOWED["ranks"] = CORE
ALLOWED["benchmark"] = CORE | {"columns", "tables"}
ALLOWED["places"] = CORE | {"columns", "tables", "benchmark"}
ALLOWED["comparison"] = CORE | {"tables", "benchmark", "places", "pictures"}
ALLOWED["card"] = CORE | {"data", "geometry", "pictures", "tables"}
ALLOWED["catalogue"] = CORE | {"checksums", "tables"}
ALLOWED["data.modules"] = ALLOWED["data"] | {"runs", "data"}
ALLOWED["data.fitting"] = ALLOWED["data"] | {"data", "data.modules"}
ALLOWED["data.training"] = ALLOWED["data.fitting"] | {"runs", "data.fitting"}
ALLOWED["tasks"] = set(ALLOWED) - {"data.modules", "data.fitting", "data.training"}
ALLOWED["terminal"] = CORE | {"machine", "tables", "comparison"}
ALLOWED["occupancy"] = CORE | {"machine", "runs", "terminal"}
ALLOWED["mistakes"] = CORE | {"terminal"}
ALLOWED["sweeps"] = CORE
ALLOWED["stopping"] = set()
ALLOWED["configuration"] = CORE | {"runs", "sweeps"}
ALLOWED["stages"] = set(ALLOWED) - {"mistakes", "configuration"}
ALLOWED["execution"] = CORE | {"configuration", "machine", "restarts", "runs", "stages"}
ALLOWED["run"] = set(ALLOWED)
# For one mesh: beside the stages, neither imports the other.
ALLOWED["api"] = CORE | {"geometry", "methods", "pretrained"}
ALLOWED["export"] = CORE | {"geometry"}
ALLOWED["cli"] = CORE | {
    "compiled",
    "geometry",
    "methods",
    "api",
    "export",
    "pictures",
    "card",
    "catalogue",
    "stopping",
}
ALLOWED["__main__"] = {"cli"}

LIGHTNING = {"stages", "data.modules", "data.fitting", "data.training", "execution"}
HYDRA = {"configuration", "execution", "mistakes", "run", "sweeps"}

LONGEST = 45  # lines of a function, its docstring included
LONG: set[str] = set()


def modules() -> list[str]:
    paths = sorted(PACKAGE.rglob("*.py"))
    names = (".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in paths)
    return [name for name in names if name != "__init__"]


def layer_of(module: str) -> str:
    module = module.removesuffix(".__init__")
    return module if module in ALLOWED else module.split(".")[0]


def imported(module: str) -> set[str]:
    """Full names of what a module imports, wherever in the file it does so."""
    path = PACKAGE / Path(*module.split(".")).with_suffix(".py")
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            names.add(node.module)
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def ours(module: str) -> set[str]:
    named = {name.removeprefix("gensp.") for name in imported(module) if name.startswith("gensp.")}
    places = {name: PACKAGE / Path(*name.split(".")) for name in named}
    return {
        name
        for name, place in places.items()
        if place.with_suffix(".py").exists() or (place / "__init__.py").exists()
    }


def test_packages_count_as_imports() -> None:
    assert {"models", "pictures", "tasks.evaluate"} <= ours("stages.evaluate")


@pytest.mark.parametrize("module", modules())
def test_imports_keep_to_the_layers(module: str) -> None:
    layer = layer_of(module)
    assert layer in ALLOWED, f"{module} belongs to no layer"
    for name in ours(module):
        may = layer_of(name) == layer or layer_of(name) in ALLOWED[layer] or name in ALLOWED[layer]
        assert may, f"{module} imports {name}"


@pytest.mark.parametrize("module", modules())
def test_outer_libraries_stay_outside(module: str) -> None:
    outer = {name.split(".")[0] for name in imported(module)}
    layer = layer_of(module)
    assert "wandb" not in outer
    assert "lightning" not in outer or layer in LIGHTNING
    assert not outer & {"hydra", "omegaconf"} or layer in HYDRA


@pytest.mark.parametrize("module", modules())
def test_functions_are_short(module: str) -> None:
    path = PACKAGE / Path(*module.split(".")).with_suffix(".py")
    nodes = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]
    lengths = {f"{module}.{n.name}": n.end_lineno - n.lineno + 1 for n in nodes if n.end_lineno}
    assert {name for name, lines in lengths.items() if lines > LONGEST} <= LONG


def test_stages_do_not_import_each_other() -> None:
    stages = {
        "prepare",
        "augment",
        "implicit",
        "correspond",
        "generator",
        "parameterize",
        "evaluate",
    }
    for stage in stages:
        named = {name.removeprefix("stages.") for name in ours(f"stages.{stage}")}
        assert not named & (stages - {stage}), stage


@pytest.mark.parametrize("light", ["gensp", "gensp.api", "gensp.cli", "gensp.compute"])
def test_light_imports(light: str) -> None:
    heavy = ["torch", "lightning", "hydra", "omegaconf", "wandb", "matplotlib"]
    script = f"import sys, {light}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_the_library_needs_no_hydra_and_no_wandb() -> None:
    script = (
        "import sys\n"
        "for name in ('hydra', 'omegaconf', 'wandb', 'lightning'): sys.modules[name] = None\n"
        "import gensp\n"
        "for name in gensp.__all__: getattr(gensp, name)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
