"""The page of `gensp view`."""

from dataclasses import replace
from pathlib import Path

from gensp.geometry.spherical_map import SphericalMap
from gensp.pictures.render import look, up_axis
from gensp.pictures.report import Page, write_report

_FACES = 100_000


def write_page(map: SphericalMap, path: Path, up: str) -> Path:
    """Write a page with the shape in one pane and its sphere in the other."""
    measured = map.distortion()
    ball = replace(map, surface=map.sphere)
    page = Page(
        title=map.name,
        subtitle=f"{len(map.sphere)} vertices · {map.certify()} · σ mean {measured.mean:.3f}, "
        f"max {measured.max:.3f} · conformal σ mean {measured.conformal_mean:.3f}",
        summary=None,
        pictures=[],
        turning={map.name: map, "sphere": ball},
        turn=look(up).rotation,
        up=up_axis(up).tolist(),
    )
    return write_report(page, path, turning_faces=_FACES)
