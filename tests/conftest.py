"""Shapes for the tests, run-time shape checks, one thread."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("IGL_NUM_THREADS", "1")

from jaxtyping import install_import_hook

install_import_hook(["gensp.geometry", "gensp.models", "gensp.losses"], "beartype.beartype")

import numpy as np
import pytest
import torch
from commands import smoke as smoke
from commands import smoke_copy as smoke_copy

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere, unit

torch.set_num_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules that run whole commands first: processes that share the modules end together."""
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in long)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.fixture
def ellipsoid() -> Mesh:
    """Semi-axes 1.5, 1, 0.7."""
    ball = icosphere(3)
    return Mesh(ball.vertices * np.array([1.5, 1.0, 0.7]), ball.faces, "ellipsoid")


@pytest.fixture
def bumpy() -> Mesh:
    """A sphere with smooth bumps, without symmetry."""
    ball = icosphere(3)
    x, y, z = ball.vertices.T
    radius = 1 + 0.25 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.15 * z * x
    return Mesh(ball.vertices * radius[:, None], ball.faces, "bumpy")


@pytest.fixture
def dumbbell() -> Mesh:
    """Two balls joined by a neck, along x."""
    ball = icosphere(3)
    x, y, z = ball.vertices.T
    waist = 0.25 + 0.75 * x**2
    return Mesh(np.stack([2 * x, waist * y, waist * z], axis=1), ball.faces, "dumbbell")


@pytest.fixture
def limbed() -> Mesh:
    """A ball with two long thin legs: their triangles vanish on the way to the sphere."""
    ball = icosphere(4)
    feet = unit(np.array([[0.4, 0.0, -1.0], [-0.4, 0.1, -1.0]]))
    squared = np.sum((ball.vertices[:, None] - feet) ** 2, axis=2)
    length = 2.5 * np.exp(-squared / 0.01).sum(axis=1)
    return Mesh(ball.vertices - length[:, None] * np.array([0.0, 0.0, 1.0]), ball.faces, "limbed")
