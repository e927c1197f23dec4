"""What the smoke pipeline ends with: bijective maps of little distortion."""

import json
from pathlib import Path

import pytest

from gensp.geometry.spherical_map import load_map
from gensp.methods.cmcf import CMCF
from gensp.methods.refinement import NoRefinement
from gensp.runs import Run

pytestmark = pytest.mark.slow

# Mean σ of a correct pipeline on the six blobs is 2.1; the flow's own maps have 12 and more.
BOUND = 2.5


def test_every_map_is_bijective_and_hardly_distorted(smoke: Path) -> None:
    run = smoke / "smoke" / "full"
    maps = [load_map(path) for path in sorted((run / "parameterize" / "maps").glob("*.npz"))]
    assert len(maps) == 6
    for map in maps:
        assert map.bad_faces().sum() == 0
        assert abs(map.degree()) == 1
        assert map.distortion().mean < BOUND
    summary = json.loads((run / "evaluate" / "summary.json").read_text())["groups"]["all"]
    assert summary["bad_faces"] == summary["affected_shapes"] == 0
    assert summary["sigma_mean"] < BOUND
    assert Run(run / "parameterize").headline == 0


def test_the_bound_tells_a_good_map_from_a_poor_one(smoke: Path) -> None:
    maps = smoke / "smoke" / "full" / "parameterize" / "maps"
    for path in sorted(maps.glob("*.npz"))[:2]:
        assert CMCF(NoRefinement())(load_map(path).mesh).distortion().mean > 2 * BOUND
