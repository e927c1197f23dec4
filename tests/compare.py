"""Whether two run folders hold the same results, times aside."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch

_NO_RESULTS = {"manifest.json", "files.csv", "config.yaml", "settings.json"}
_NO_RESULT_FOLDERS = {"logs", "checkpoints"}
# How long it took, and whether a cache of what a killed process made had it.
_NO_RESULT_KEYS = ("seconds", "cached")


def results(folder: Path) -> set[str]:
    """Relative paths of what a stage made."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {
        path.as_posix()
        for path in paths
        if path.name not in _NO_RESULTS and not _NO_RESULT_FOLDERS & set(path.parts)
    }


def different(first: Path, second: Path) -> list[str]:
    """Relative paths of files that one folder lacks, or that differ in a bit."""
    ours, theirs = results(first), results(second)
    differing = [name for name in ours & theirs if load(first / name) != load(second / name)]
    return sorted([*(ours ^ theirs), *differing])


def load(path: Path) -> Any:
    """The content of a file in a form that compares bit by bit; `_NO_RESULT_KEYS` left out."""
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {
                name: (arrays[name].dtype.str, arrays[name].shape, arrays[name].tobytes())
                for name in arrays.files
                if "seconds" not in name
            }
    if path.suffix == ".pt":
        return _tensors(torch.load(path, weights_only=True))
    if path.suffix == ".json":
        return _timeless(json.loads(path.read_text()))
    if path.suffix == ".csv":
        with open(path) as file:
            return [_timeless(row) for row in csv.DictReader(file)]
    if path.suffix == ".md":
        return _timeless_tables(path.read_text())
    if path.suffix == ".html":
        return _timeless_page(path.read_text())
    return path.read_bytes()


def _tensors(node: Any) -> Any:
    if isinstance(node, torch.Tensor):
        return (str(node.dtype), tuple(node.shape), node.numpy().tobytes())
    if isinstance(node, dict):
        return {name: _tensors(value) for name, value in node.items()}
    return node


def _timeless(node: Any) -> Any:
    if isinstance(node, dict):
        return {
            key: _timeless(value)
            for key, value in node.items()
            if not any(word in key for word in _NO_RESULT_KEYS)
        }
    return [_timeless(value) for value in node] if isinstance(node, list) else node


def _timeless_tables(markdown: str) -> list[list[str]]:
    """Cells of every line, those below a heading "seconds" left out."""
    lines, timed = [], set[int]()
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) == 1:
            timed = set()
        timed |= {place for place, cell in enumerate(cells) if cell == "seconds"}
        lines.append([cell for place, cell in enumerate(cells) if place not in timed])
    return lines


def _timeless_page(html: str) -> list[list[str]]:
    """The page in pieces: rows of tables as their cells, without seconds and without settings."""
    page = re.sub(r"<section><h2>How it was made</h2>.*?</section>", "", html, flags=re.DOTALL)
    page = re.sub(r"<b>[^<]*</b><span>seconds</span>", "", page)
    page = re.sub(r"</t[hd]><t[hd][^>]*>", " | ", page)
    lines = re.sub(r"</?(?:table|thead|tbody|tr|th|td)\b[^>]*>", "\n", page)
    return _timeless_tables(re.sub(r"\n+", "\n", lines))
