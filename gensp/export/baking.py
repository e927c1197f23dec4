"""The texture of a shape as a picture of the sphere, read through its map."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, UInt8

from gensp.errors import UnreadableMesh
from gensp.geometry.distance import ClosestPointTree
from gensp.geometry.mesh import Mesh
from gensp.geometry.spherical_map import SphericalMap
from gensp.geometry.texture_coordinates import equirectangular_directions

_FAR = 1e-3  # of √area: how far the textured mesh may be from the map's surface


def read_textured(path: Path) -> Any:
    """A trimesh with texture coordinates and a picture, from OBJ or GLB.

    Raises
    ------
    UnreadableMesh
        The file cannot be read, or has no texture coordinates or picture.
    """
    try:
        loaded: Any = trimesh.load(path, process=False, force="mesh")
        material = getattr(loaded.visual, "material", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        uv = getattr(loaded.visual, "uv", None)
    # Readers of damaged files raise whatever their parser met; the file is at fault in each case.
    except Exception as error:
        raise UnreadableMesh(
            f"{path}: cannot be read ({type(error).__name__}); an OBJ or GLB with texture "
            "coordinates and a picture is required; export it again"
        ) from error
    if uv is None or image is None:
        raise UnreadableMesh(
            f"{path}: has no texture coordinates or no picture; both are required; export it "
            "again, with its picture beside it"
        )
    return loaded


def baked_picture(
    textured: Any,
    map: SphericalMap,
    height: int,
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """The texture by longitude and latitude of R m(x); no seam of the original is crossed.

    Every pixel goes to the surface through the map, from there to the nearest point of the
    textured mesh, and takes the colour at its texture coordinates.

    Raises
    ------
    UnreadableMesh
        The textured mesh is not the map's surface.
    """
    directions = equirectangular_directions(height)
    p = directions.reshape(-1, 3)
    points = map.to_surface(p if rotation is None else p @ rotation)
    skin = Mesh(np.array(textured.vertices), np.array(textured.faces, dtype=np.int64))
    found = ClosestPointTree(skin).query(points)
    if found.distance.max() > _FAR * np.sqrt(map.mesh.area):
        raise UnreadableMesh(
            f"{map.name}: the textured mesh is up to {found.distance.max():.3g} away from the "
            "map's surface; the same surface at the same place is required; name the mesh that "
            "was parameterized"
        )
    uv = found.at.on(np.array(textured.visual.uv), skin.faces)
    material = textured.visual.material
    picture = getattr(material, "baseColorTexture", None) or material.image
    colours = trimesh.visual.color.uv_to_interpolated_color(uv, picture.convert("RGB"))
    return colours[:, :3].astype(np.uint8).reshape(directions.shape)
