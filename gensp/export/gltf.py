"""A textured surface in one binary glTF file."""

from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import UInt8
from PIL import Image

from gensp.files import atomic_path
from gensp.geometry.texture_coordinates import Unwrapped


def write_glb(path: Path, surface: Unwrapped, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write a GLB with the picture inside; u beyond 1 repeats, as glTF has it by default.

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
    content = trimesh.exchange.gltf.export_glb(trimesh.Scene(solid), include_normals=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
