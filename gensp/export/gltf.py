"""A textured surface in one binary glTF file."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import UInt8
from PIL import Image

from gensp.files import atomic_path
from gensp.geometry.texture_coordinates import Unwrapped

_LINEAR, _REPEAT, _CLAMP = 9729, 10497, 33071  # glTF 2.0, section 5.26


def write_glb(path: Path, surface: Unwrapped, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a GLB with the picture inside; u beyond 1 repeats.

    Copies of a vertex share its normal, so no shading tells where the picture is cut.
    """
    whole, place = surface.whole()
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(picture), metallicFactor=0.0, roughnessFactor=0.7
    )
    solid = trimesh.Trimesh(
        surface.vertices,
        surface.faces,
        vertex_normals=whole.vertex_normals[place],
        visual=trimesh.visual.TextureVisuals(uv=surface.uv, material=material),
        process=False,
    )
    content = trimesh.exchange.gltf.export_glb(
        trimesh.Scene(solid), include_normals=True, tree_postprocessor=_without_mipmaps
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def _without_mipmaps(tree: dict[str, Any]) -> None:
    """Have pictures read at full size: around the poles u runs so fast that mipmaps blur them."""
    tree["samplers"] = [
        {"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": _REPEAT, "wrapT": _CLAMP}
    ]
    for texture in tree["textures"]:
        texture["sampler"] = 0
