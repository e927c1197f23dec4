"""A spherical map's surface wearing a picture of the sphere, in the two usual formats."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gensp.export.gltf import write_glb
from gensp.export.wavefront import write_textured_obj
from gensp.geometry.spherical_map import SphericalMap
from gensp.geometry.texture_coordinates import unwrap


def write_textured(
    map: SphericalMap, picture: UInt8[np.ndarray, "h w 3"], stem: Path
) -> list[Path]:
    """Write <stem>.glb, and <stem>.obj with its mtl and png; gives the four paths.

    `picture` is by longitude and latitude, the pole +z on top.
    """
    surface = unwrap(map.surface, map.sphere, map.faces)
    # Not with_suffix: a dot in the name is part of it.
    glb, obj = (stem.parent / (stem.name + end) for end in (".glb", ".obj"))
    write_glb(glb, surface, picture)
    write_textured_obj(obj, surface, picture)
    return [glb, obj, obj.with_suffix(".mtl"), obj.with_suffix(".png")]
