"""Small trees in the layouts of ShapeNetCore.v2, KeypointNet, D-FAUST, and of a finished stage."""

import json
from pathlib import Path

import h5py
import numpy as np
import yaml

from gensp.geometry.mesh import Mesh
from gensp.geometry.sphere import icosphere
from gensp.pretrained import FITS

BALL = icosphere(2)
BOTTLE, KNIFE = "02876657", "03624134"
ANNOTATED, SKEWED = "a" * 32, "b" * 32


def unwelded_obj(parts: list[Mesh]) -> str:
    """Groups of triangles with normals that share no vertex, as ShapeNet stores models."""
    lines, count = ["mtllib model_normalized.mtl"], 0
    for number, part in enumerate(parts):
        lines.append(f"g part{number}")
        for corner in part.vertices[part.faces].reshape(-1, 3):
            lines.append("v " + " ".join(f"{value:.6f}" for value in corner))
        lines.append("usemtl grey")
        for start in range(count + 1, count + 3 * len(part.faces) + 1, 3):
            lines.append("f " + " ".join(f"{start + k}//{start + k}" for k in range(3)))
        count += 3 * len(part.faces)
    return "\n".join(lines) + "\n"


def two_balls(apart: float) -> list[Mesh]:
    """Two balls of radius 0.3, the second moved along x."""
    first = BALL.vertices * 0.3
    return [Mesh(first, BALL.faces), Mesh(first + np.array([apart, 0.0, 0.0]), BALL.faces)]


def ring() -> Mesh:
    """A torus."""
    i, j = np.meshgrid(np.arange(24), np.arange(12), indexing="ij")
    u, v = 2 * np.pi * i / 24, 2 * np.pi * j / 12
    radius = 0.4 + 0.12 * np.cos(v)
    places = np.stack([radius * np.cos(u), radius * np.sin(u), 0.12 * np.sin(v)], axis=-1)
    a, b = i * 12 + j, (i + 1) % 24 * 12 + j
    c, d = (i + 1) % 24 * 12 + (j + 1) % 12, i * 12 + (j + 1) % 12
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return Mesh(places.reshape(-1, 3), faces)


def keypoints(model: str, parts: list[Mesh], shift: float) -> dict:
    """Three keypoints at corners of the first part's faces, a reflection of the last two."""
    points = [
        {
            "xyz": (parts[0].vertices[parts[0].faces[face, 0]] + shift).tolist(),
            "rgb": [128, 128, 128],
            "semantic_id": 4 + k,
            "pcd_info": {"point_index": k},
            "mesh_info": {"face_index": face, "face_uv": [1.0, 0.0, 0.0]},
        }
        for k, face in enumerate((0, 60, 200))
    ]
    symmetries = {"reflection": [{"kp_indexes": [1, 2]}], "rotation": []}
    known = {"class_id": BOTTLE, "model_id": model}
    return {**known, "keypoints": points, "symmetries": symmetries}


def write_shapenet(root: Path) -> Path:
    """Two bottles of two overlapping balls, one without a file, and a knife with a handle."""
    taxonomy = [
        {"synsetId": BOTTLE, "name": "bottle", "children": [], "numInstances": 3},
        {"synsetId": KNIFE, "name": "knife,blade", "children": [], "numInstances": 1},
    ]
    models = {
        (BOTTLE, ANNOTATED): two_balls(0.35),
        (BOTTLE, SKEWED): two_balls(0.25),
        (KNIFE, "d" * 32): [ring()],
    }
    root.mkdir(parents=True)
    (root / "taxonomy.json").write_text(json.dumps(taxonomy))
    for (synset, model), parts in models.items():
        folder = root / synset / model / "models"
        folder.mkdir(parents=True)
        (folder / "model_normalized.obj").write_text(unwelded_obj(parts))
    (root / BOTTLE / ("c" * 32) / "models").mkdir(parents=True)
    rows = [f"{k:06d},{s},{s},{m},{'test' if k else 'train'}" for k, (s, m) in enumerate(models)]
    head = "id,synsetId,subSynsetId,modelId,split"
    (root / "all.csv").write_text("\n".join([head, *rows]) + "\n")
    return root


def write_keypointnet(root: Path) -> Path:
    """Annotations of both bottles, the second of them beside its model; splits."""
    (root / "annotations").mkdir(parents=True)
    (root / "splits").mkdir()
    records = [
        keypoints(ANNOTATED, two_balls(0.35), 0.0),
        keypoints(SKEWED, two_balls(0.25), 0.2),
    ]
    (root / "annotations" / "bottle.json").write_text(json.dumps(records))
    (root / "splits" / "train.txt").write_text(f"{BOTTLE}-{SKEWED}\n")
    (root / "splits" / "test.txt").write_text(f"{BOTTLE}-{ANNOTATED}\n")
    return root


SEQUENCES = {"f": ("50004_hips", "50020_knees"), "m": ("50002_hips",)}


def write_dfaust(root: Path, frames: int = 4) -> Path:
    """Breathing balls in one connectivity, in two files of one or two sequences."""
    root.mkdir(parents=True)
    grown = 1 + 0.1 * np.arange(frames)
    for sex, names in SEQUENCES.items():
        with h5py.File(root / f"registrations_{sex}.hdf5", "w") as file:
            file["faces"] = BALL.faces.astype(np.uint32)
            for name in names:
                motion = BALL.vertices[:, :, None] * grown
                file[name] = motion.astype(np.float32)
    return root


def write_parameterization(folder: Path) -> Path:
    """What stage=parameterize leaves of its configuration; gives the file."""
    fit = {"_target_": FITS["register"], "level": 4}
    refine = {
        "_target_": "gensp.methods.refinement.CertifiedRefinement",
        "pull": 7.0,
        "energy": "sigma",
    }
    config = {
        "method": {"name": "gensp", "object": {"level": 5, "fit": fit}},
        "fit": {"own": 0.5},
        "refine": {"object": refine},
        "data": {"root": None, "seeds": [0, 1], "made": "2026-01-01"},
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "manifest.json").write_text("{}")
    return folder / "config.yaml"
