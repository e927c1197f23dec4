from pathlib import Path

import numpy as np
import pytest
import torch

from gensp.errors import Unsupported
from gensp.geometry.mesh import Mesh, normalize
from gensp.geometry.sphere import icosphere
from gensp.geometry.spherical_map import SphericalMap
from gensp.methods import SphericalParameterization
from gensp.methods.fitting import Known, SurfaceOnSphere
from gensp.methods.gensp import GenSP
from gensp.models import AnchoredGenerator, PointNet2Encoder, save_model


def networks() -> dict:
    torch.manual_seed(0)
    generator = AnchoredGenerator(6, rank=2, width=16, depth=2)
    torch.nn.init.normal_(generator.trunk.last.weight, std=0.05)
    encoder = PointNet2Encoder(6, width=8, groups=((32, 8), (8, 4)))
    return {"encoder": encoder, "generator": generator}


def unfitted(generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
    return generated


def unrefined(
    mesh: Mesh, start: np.ndarray, target: np.ndarray, trust: np.ndarray
) -> SphericalMap:
    assert np.array_equal(start, target)
    assert trust.shape == (len(mesh.vertices),)
    return SphericalMap(start, mesh.vertices, mesh.faces, mesh.name, {"rung": "none"})


def onto(generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
    """A registration that knows the answer: the mesh is a stretched icosphere itself."""
    return SurfaceOnSphere(mesh, generated.sphere)


SETTINGS = {"fit": unfitted, "refine": unrefined, "level": 3, "points": 128, "draws": 8}


def test_map_keeps_the_input_and_its_order(bumpy: Mesh) -> None:
    method: SphericalParameterization = GenSP(**networks(), **SETTINGS)
    raw = Mesh(3 * bumpy.vertices + 7, bumpy.faces, "raw")
    result = method(raw)
    assert np.array_equal(result.surface, raw.vertices)
    assert np.array_equal(result.faces, raw.faces)
    assert result.name == "raw"
    np.testing.assert_allclose(np.linalg.norm(result.sphere, axis=1), 1)
    assert result.sphere.dtype == np.float64
    assert {"predicted", "generated", "code"} <= result.arrays.keys()
    parts = [v for k, v in result.diagnostics.items() if k.startswith("seconds_")]
    assert result.diagnostics["seconds"] == pytest.approx(sum(parts))
    assert result.diagnostics["rung"] == "none"


def test_code_depends_on_the_shape_alone(bumpy: Mesh) -> None:
    method = GenSP(**networks(), **SETTINGS)
    moved = Mesh(2.0 * bumpy.vertices, bumpy.faces, "twice")
    first, second = method.encode(normalize(bumpy)), method.encode(normalize(bumpy))
    assert np.array_equal(first, second)
    np.testing.assert_allclose(
        method.generate(first).vertices, method(moved).arrays["generated"], atol=0.2
    )


def test_zero_code_generates_the_sphere() -> None:
    image = GenSP(**networks(), **SETTINGS).generate(np.zeros(6, np.float32), level=2)
    np.testing.assert_allclose(image.vertices, icosphere(2).vertices, atol=1e-7)
    assert np.array_equal(image.faces, icosphere(2).faces)


def test_exact_generated_surface_is_inverted_exactly(bumpy: Mesh) -> None:
    method = GenSP(**networks(), **{**SETTINGS, "fit": onto})
    result = method(bumpy)
    np.testing.assert_allclose(result.sphere, icosphere(3).vertices, atol=1e-9)
    assert not result.bad_faces().any()


def test_loaded_method_maps_as_the_one_that_was_saved(tmp_path: Path, ellipsoid: Mesh) -> None:
    save_model(tmp_path / "model.pt", **networks())
    loaded = GenSP.load(tmp_path / "model.pt", **SETTINGS)
    expected = GenSP(**networks(), **SETTINGS)(ellipsoid)
    assert np.array_equal(loaded(ellipsoid).sphere, expected.sphere)


def test_model_knows_the_clouds_that_it_was_trained_on(tmp_path: Path, bumpy: Mesh) -> None:
    trained, path = networks(), tmp_path / "model.pt"
    trained["encoder"].set_origin(torch.randn(3, 96, 3))
    save_model(path, **trained)
    loaded = GenSP.load(path, fit=unfitted, refine=unrefined)
    assert (loaded.points, loaded.draws) == (96, 3)
    same = GenSP(**trained, fit=unfitted, refine=unrefined, points=96, draws=3)
    assert np.array_equal(loaded.encode(bumpy), same.encode(bumpy))
    other = GenSP.load(path, fit=unfitted, refine=unrefined, points=128, draws=1)
    assert (other.points, other.draws) == (128, 1)


def test_model_that_does_not_tell_its_clouds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    save_model(path, **networks())
    with pytest.raises(Unsupported, match=r"points: the encoder does not tell .*points=NUMBER"):
        GenSP.load(path, fit=unfitted, refine=unrefined)
    with pytest.raises(Unsupported, match="draws: "):
        GenSP.load(path, fit=unfitted, refine=unrefined, points=128)


def test_model_that_lacks_the_mean_image_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    save_model(path, **networks())
    content = torch.load(path, weights_only=True)
    del content["generator"]["state_dict"]["mean_image"]
    torch.save(content, path)
    with pytest.raises(Unsupported, match="weights of another architecture"):
        GenSP.load(path, **SETTINGS)


def test_model_without_generator_is_refused(tmp_path: Path) -> None:
    save_model(tmp_path / "model.pt", encoder=networks()["encoder"])
    with pytest.raises(Unsupported, match="encoder and generator are required"):
        GenSP.load(tmp_path / "model.pt", **SETTINGS)


def test_method_needs_neither_lightning_nor_hydra() -> None:
    import subprocess
    import sys

    code = "import sys, gensp.methods.gensp; print({'lightning', 'hydra'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_fitted_surface_lies_between_the_mean_image_and_the_own(bumpy: Mesh) -> None:
    parts = networks()
    parts["generator"].mean_code.copy_(torch.linspace(-1, 1, 6))
    parts["generator"].mean_image = torch.from_numpy(1.2 * icosphere(3).vertices).float()
    seen: list[Mesh] = []

    def watched(generated: SurfaceOnSphere, mesh: Mesh, known: Known) -> SurfaceOnSphere:
        seen.append(generated.mesh)
        return generated

    for own in (0.0, 0.5, 1.0):
        method = GenSP(**parts, **{**SETTINGS, "fit": watched}, own=own)
        code = method(bumpy).arrays["code"]
    mean = parts["generator"].mean_code.numpy()
    at_mean, between = (method.generate(z).vertices for z in (mean, (mean + code) / 2))
    np.testing.assert_allclose(seen[0].vertices, 1.2 * icosphere(3).vertices, atol=1e-6)
    added = between - at_mean
    np.testing.assert_allclose(seen[1].vertices - seen[0].vertices, added, atol=1e-6)
    assert np.array_equal(seen[2].vertices, method.generate(code).vertices)


def test_a_finer_surface_keeps_its_detail_around_the_mean_image(bumpy: Mesh) -> None:
    parts = networks()
    parts["generator"].mean_image = torch.from_numpy(icosphere(2).vertices + 0.5).float()
    method = GenSP(**parts, **{**SETTINGS, "fit": unfitted}, own=0.0)
    source = method(bumpy).arrays["fitted"]
    # At code zero the generator is the sphere; the image is that sphere, moved.
    np.testing.assert_allclose(source, icosphere(3).vertices + 0.5, atol=1e-6)


def test_a_model_without_a_mean_image_says_so(bumpy: Mesh) -> None:
    method = GenSP(**networks(), **SETTINGS, own=0.0)
    with pytest.raises(Unsupported, match=r"no mean image.*recipe\.fit\.own=1"):
        method(bumpy)


def test_the_mean_image_travels_with_the_weights(tmp_path: Path) -> None:
    parts = networks()
    parts["generator"].mean_image = torch.rand(42, 3)
    save_model(tmp_path / "model.pt", **parts)
    loaded = GenSP.load(tmp_path / "model.pt", **SETTINGS)
    assert torch.equal(loaded.generator.mean_image, parts["generator"].mean_image)
