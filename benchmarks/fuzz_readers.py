"""The readers of files from elsewhere, each with valid files made by the writers."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from layouts import write_dfaust, write_keypointnet, write_parameterization, write_shapenet

from gensp.catalogue import find_runs, listed
from gensp.checksums import FILES
from gensp.cli.inputs import read_map
from gensp.cli.transfer import _read as read_attribute
from gensp.compute import finished_row, row_path
from gensp.data.dfaust import DFaust
from gensp.data.ground_truth import GroundTruth, load_ground_truth, save_ground_truth
from gensp.data.keypoints import keypoints_of, load_keypoint_records, symmetry_groups
from gensp.data.sdf import SdfSampler, cached_samples
from gensp.data.shapenet import ShapeNet
from gensp.data.shapes import ShapeCollection
from gensp.data.split_lists import read_splits
from gensp.export.baking import read_textured
from gensp.export.polygons import write_ply
from gensp.export.textured import write_textured
from gensp.files import read_yaml, save_npz, write_json
from gensp.geometry.diagnosis import diagnose
from gensp.geometry.mesh import load_mesh, require_genus_zero, save_mesh
from gensp.geometry.points import SurfacePoints
from gensp.geometry.sphere import icosphere
from gensp.geometry.sphere_files import read_sphere_positions, write_for_program
from gensp.geometry.spherical_map import SphericalMap, load_map, save_map
from gensp.models.encoder import PointNet2Encoder
from gensp.models.generator import DirectGenerator
from gensp.models.store import load_model, save_model
from gensp.pretrained.ship import entry_of
from gensp.restarts import begin, restart
from gensp.runs import Run, seal
from gensp.stages.callbacks import WholeCheckpoints

BALL = icosphere(1)
SETTINGS = {"stage": {"name": "implicit", "rate": 0.1}, "seed": 0}
_SAMPLER = SdfSampler(near=20, far=20, uniform=20)


@dataclass(frozen=True)
class Reader:
    """What writes valid files into a folder, and what reads one of them."""

    name: str
    write: Callable[[Path], list[Path]]
    read: Callable[[Path], object]


def _mesh_files(suffix: str) -> Callable[[Path], list[Path]]:
    def write(folder: Path) -> list[Path]:
        save_mesh(BALL, folder / f"binary{suffix}")
        if suffix not in (".ply", ".stl"):
            return [folder / f"binary{suffix}"]
        kind = "ascii" if suffix == ".ply" else "stl_ascii"
        words = {"encoding": kind} if suffix == ".ply" else {"file_type": kind}
        text = trimesh.Trimesh(BALL.vertices, BALL.faces, process=False).export(
            **{"file_type": suffix[1:], **words}
        )
        data = text if isinstance(text, bytes) else text.encode()
        (folder / f"text{suffix}").write_bytes(data)
        return [folder / f"binary{suffix}", folder / f"text{suffix}"]

    return write


def _mesh(path: Path) -> None:
    mesh = load_mesh(path)
    diagnose(mesh)
    require_genus_zero(mesh)


def _map_files(folder: Path) -> list[Path]:
    reliability = {"reliability": np.ones(len(BALL.vertices))}
    save_map(SphericalMap(BALL.vertices, BALL.vertices, BALL.faces, "a", reliability), folder)
    return [folder / "a.npz"]


def _map(path: Path) -> None:
    load_map(path)
    read_map(path)


def _truth_files(folder: Path) -> list[Path]:
    at = SurfacePoints(np.arange(20), np.full((20, 3), 1 / 3))
    save_ground_truth(folder / "truth.npz", GroundTruth("t", np.arange(20), at))
    return [folder / "truth.npz"]


def _sample_files(folder: Path) -> list[Path]:
    cached_samples(BALL, _SAMPLER, 1.5, folder)
    return list(folder.rglob("*.npz"))


def _samples(path: Path) -> None:
    found = cached_samples(BALL, _SAMPLER, 1.5, path.parent)
    assert (found.distances == _SAMPLER(BALL, 1.5).distances).all(), "other samples"


def _attribute_files(folder: Path) -> list[Path]:
    save_npz(folder / "a.npz", values=np.arange(42.0))
    write_ply(folder / "a.ply", BALL, np.full((42, 3), 9, np.uint8))
    return [folder / "a.npz", folder / "a.ply"]


def _attribute(path: Path) -> None:
    read_attribute(str(path) if path.suffix == ".ply" else f"{path}:values")


def _textured_files(folder: Path) -> list[Path]:
    map = SphericalMap(BALL.vertices, BALL.vertices, BALL.faces, "a")
    return write_textured(map, np.zeros((8, 16, 3), np.uint8), folder / "a")


def _textured(path: Path) -> None:
    read_textured(path if path.suffix == ".glb" else path.with_suffix(".obj"))


def _sphere_files(folder: Path) -> list[Path]:
    write_for_program(BALL, folder / "a.obj")
    save_map(SphericalMap(BALL.vertices, BALL.vertices, BALL.faces, "b"), folder)
    lines = [
        f"Vertex {k + 1} {x} {y} {z} {{sph=({x} {y} {z})}}"
        for k, (x, y, z) in enumerate(BALL.vertices)
    ]
    (folder / "a.m").write_text("\n".join(lines))
    return [folder / "a.obj", folder / "b.ply", folder / "a.m"]


def _manifest_files(folder: Path) -> list[Path]:
    for name in ("a", "b"):
        save_mesh(BALL, folder / "meshes" / f"{name}.ply")
    head = "file,split,category,template,correspondence\n"
    rows = [f"meshes/{name}.ply,train,ball,t,\n" for name in ("a", "b")]
    (folder / "manifest.csv").write_text(head + "".join(rows))
    return [folder / "manifest.csv"]


def _manifest(path: Path) -> None:
    found = ShapeCollection.from_folder(path.parent, on_bad="skip")
    assert all("/" not in id and id not in ("", ".", "..") for id in found.ids()), found.ids()
    for id in found.ids():
        found.columns(id)
        found.ground_truth(id)


def _keypoint_files(folder: Path) -> list[Path]:
    return [write_keypointnet(folder / "known") / "annotations" / "bottle.json"]


def _keypoints(path: Path) -> None:
    for record in load_keypoint_records(path).values():
        keypoints_of(record)
        symmetry_groups(record)


def _split_files(folder: Path) -> list[Path]:
    root = write_shapenet(folder / "shapenet")
    return [root / "all.csv", root / "taxonomy.json"]


def _splits(path: Path) -> None:
    read_splits(path.parent / "all.csv")
    ShapeNet(path.parent, on_bad="keep", split_file=path.parent / "all.csv")


def _dfaust_files(folder: Path) -> list[Path]:
    return sorted(write_dfaust(folder / "dfaust").glob("*.hdf5"))


def _dfaust(path: Path) -> None:
    found = DFaust(path.parent, on_bad="keep", train=None, test=None, points=None)
    for id in found.ids()[:8]:
        diagnose(found.mesh(id))
        found.ground_truth(id)


def _model_files(folder: Path) -> list[Path]:
    groups = [[8, 4], [4, 4]]
    encoder = PointNet2Encoder(latent=4, width=4, groups=groups, radii=[None, None])
    generator = DirectGenerator(latent=4, width=8, depth=2, inject=[], octaves=1)
    save_model(folder / "model.pt", encoder=encoder, generator=generator)
    return [folder / "model.pt"]


def _checkpoint_files(folder: Path) -> list[Path]:
    import torch

    state = {"state_dict": {"w": torch.ones(4, 4)}, "epoch": 3, "history": [{"loss": 1.0}]}
    WholeCheckpoints().save_checkpoint(state, folder / "last.ckpt")
    return [folder / "last.ckpt"]


def _run_files(folder: Path) -> list[Path]:
    run = folder / "implicit"
    begin(run, SETTINGS)
    seal(run, stage="implicit", settings=SETTINGS, metrics={"loss": 0.5}, facts={"seconds": 1})
    begin(folder / "other", SETTINGS)
    return [run / "manifest.json", folder / "other" / "settings.json"]


def _run(path: Path) -> None:
    restart(path.parent, SETTINGS)
    listed(find_runs(path.parent.parent))


def _list_files(folder: Path) -> list[Path]:
    run = _run_files(folder)[0].parent
    return [run / FILES, run / "manifest.json"]


def _row_files(folder: Path) -> list[Path]:
    write_json(row_path(folder, "a"), {"id": "a", "seconds": 1.0})
    return [row_path(folder, "a")]


READERS = (
    *(Reader(f"mesh {kind}", _mesh_files(f".{kind}"), _mesh) for kind in ("ply", "off", "stl")),
    Reader("mesh obj", _mesh_files(".obj"), _mesh),
    Reader("map npz", _map_files, _map),
    Reader("ground truth npz", _truth_files, lambda path: load_ground_truth(path, "t")),
    Reader("cached samples npz", _sample_files, _samples),
    Reader("attribute npz, ply", _attribute_files, _attribute),
    Reader("textured obj, glb", _textured_files, _textured),
    Reader("sphere obj, ply, m", _sphere_files, lambda path: read_sphere_positions(path, 42)),
    Reader("manifest csv", _manifest_files, _manifest),
    Reader("keypoints json", _keypoint_files, _keypoints),
    Reader("ShapeNet csv, json", _split_files, _splits),
    Reader("D-FAUST hdf5", _dfaust_files, _dfaust),
    Reader("model pt", _model_files, load_model),
    Reader("checkpoint", _checkpoint_files, WholeCheckpoints().load_checkpoint),
    Reader("run json", _run_files, _run),
    Reader("run files csv", _list_files, lambda path: Run(path.parent).outputs),
    Reader("run config yaml", lambda folder: [write_parameterization(folder)], read_yaml),
    Reader(
        "shipped model",
        lambda folder: [write_parameterization(folder)],
        lambda path: entry_of(path.parent),
    ),
    Reader("row json", _row_files, lambda path: finished_row(path.parent.parent, "a")),
)
