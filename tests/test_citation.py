"""What is to be cited is what is installed."""

import importlib.metadata
from pathlib import Path

import yaml

import gensp

ROOT = Path(__file__).parents[1]


def test_versions_agree() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == gensp.__version__ == importlib.metadata.version("gensp")
    assert cited["license"] == importlib.metadata.metadata("gensp")["License-Expression"]
