"""Programs of other authors, played by small scripts that write their formats."""

import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig

from gensp.errors import ExternalToolFailed, UnreadableMesh
from gensp.geometry.mesh import load_mesh
from gensp.geometry.sphere import unit
from gensp.geometry.sphere_files import read_sphere_positions, write_for_program
from gensp.geometry.spherical_map import SphericalMap, save_map
from gensp.methods.external import External, Step

CONF = Path(__file__).parents[1] / "conf"

# Every program here sends a vertex to its own direction.
PLY = """
from gensp.geometry.mesh import load_mesh
from gensp.geometry.sphere import unit
import numpy as np
mesh = load_mesh(sys.argv[2])
both = np.concatenate([mesh.vertices, unit(mesh.vertices)], axis=1)
rows = [" ".join(map(repr, [*row, 255, 0, 0])) for row in both.tolist()]
faces = ["3 %d %d %d" % tuple(face) for face in mesh.faces]
names = [f"property double {name}" for name in ("x", "y", "z", "px", "py", "pz")]
names += [f"property uchar {name}" for name in ("red", "green", "blue")]
head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *names]
head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
open(sys.argv[4], "w").write("\\n".join([*head, *rows, *faces]) + "\\n")
"""
OBJ = """
for line in open(sys.argv[1]):
    words = line.split()
    if words[0] == "v":
        x = [float(word) for word in words[1:]]
        length = sum(value * value for value in x) ** 0.5
        line = "v %.17g %.17g %.17g\\n" % tuple(value / length for value in x)
    open(sys.argv[2], "a").write(line)
"""
# The second of two steps: standard output, six digits, vertices in another order.
M = """
lines = [line.split() for line in open(sys.argv[1])]
vertices = [words for words in lines if words[0] == "Vertex"]
for _, number, *x in reversed(vertices):
    x = [float(word) for word in x]
    length = sum(value * value for value in x) ** 0.5
    sph = " ".join("%g" % (value / length) for value in x)
    print(f"Vertex {number}  1 2 3 {{normal=(0 0 1) sph=({sph}) uv=(0.5 0.5)}}")
for words in lines:
    if words[0] == "Face":
        print(" ".join(words))
"""
COPY = "print(open(sys.argv[1]).read(), end='')"

# Stand-ins for every program that conf/method/external.yaml names. They take the arguments of the
# command line, and those of a chain insist on what the one before left.
SIMPLIFY = """
mesh, *options = sys.argv[1:]
assert options[:3] == ["-minqem", "-vsgeom", "-dihallow"] and options[-1] == "-simplify"
named = dict(zip(options[3:-1:2], options[4:-1:2]))
open(named["-original_indices"], "w").write("order")
open(named["-prog"], "w").write("first\\nlast\\n")
assert "Vertex" in open(mesh).read()
print("base")
"""
REVERSE = "print(''.join(reversed(open(sys.argv[1]).readlines())), end='')"
FILTER = """
named = dict(zip(sys.argv[1:-1:2], sys.argv[2:-1:2]))
assert open(named["-fbase"]).read() == "base\\n" and sys.argv[-1] == "-pm"
assert open(named["-fprog"]).read() == "last\\nfirst\\n"
print("progressive")
"""
PARAMETERIZE = """
mesh, *options = sys.argv[1:]
named = dict(zip(options[::2], options[1::2]))
assert open(mesh).read() == "progressive\\n" and named["-to"] == "original_mesh"
assert open(named["-original_indices"]).read() == "order"
sys.argv[1] = named["-original_mesh"]
"""
STANDINS = {
    "SphereMap": {"SphereMap": PLY},
    "SphereParam": {
        "MeshSimplify": SIMPLIFY,
        "reverselines": REVERSE,
        "Filterprog": FILTER,
        "SphereParam": PARAMETERIZE + M,
    },
    "SphereEmbedding": {"SphereEmbedding": OBJ},
}


@pytest.fixture
def program(tmp_path):
    """Make an executable script of a name in a folder."""

    def make(name: str, body: str) -> Path:
        path = tmp_path / "programs" / name
        path.parent.mkdir(exist_ok=True)
        root = str(Path(__file__).parents[1])
        head = f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {root!r})\n"
        path.write_text(head + body)
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path.parent

    return make


def test_ply_program_gives_its_positions(program, bumpy):
    folder = program("SphereMap", PLY)
    command = ["SphereMap", "--in", "mesh.ply", "--out", "sphere.ply"]
    map = External([Step(command)], "mesh.ply", "sphere.ply", folder, name="SphereMap")(bumpy)
    np.testing.assert_allclose(map.sphere, unit(bumpy.vertices), atol=1e-15)
    np.testing.assert_array_equal(map.surface, bumpy.vertices)
    assert map.name == "bumpy"
    assert map.diagnostics["bad_faces"] == 0
    assert map.diagnostics["seconds"] > 0


def configured(*words: str) -> DictConfig:
    """The method as its configuration has it."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("config", ["stage=parameterize", "method=external", *words]).method


def test_every_tool_of_the_configuration_has_a_stand_in():
    assert set(configured().tools) == set(STANDINS)


@pytest.mark.parametrize("tool", STANDINS)
def test_command_lines_of_the_configuration(program, bumpy, tool):
    for name, body in STANDINS[tool].items():
        folder = program(name, body)
    method = instantiate(configured(f"method.tool={tool}", f"method.programs={folder}").object)
    map = method()(bumpy)
    np.testing.assert_allclose(map.sphere, unit(bumpy.vertices), atol=2e-6)
    assert map.diagnostics["bad_faces"] == 0


def test_obj_program_gives_its_positions(program, bumpy):
    folder = program("SphereEmbedding", OBJ)
    steps = [Step(["SphereEmbedding", "mesh.obj", "sphere.obj"])]
    map = External(steps, "mesh.obj", "sphere.obj", folder)(bumpy)
    np.testing.assert_allclose(map.sphere, unit(bumpy.vertices), atol=1e-15)


def test_steps_hand_over_their_output_and_m_files_may_be_in_any_order(program, bumpy):
    program("first", COPY)
    folder = program("second", M)
    steps = [Step(["first", "mesh.m"], "copy.m"), Step(["second", "copy.m"], "sphere.m")]
    map = External(steps, "mesh.m", "sphere.m", folder)(bumpy)
    np.testing.assert_allclose(map.sphere, unit(bumpy.vertices), atol=2e-6)


def test_programs_are_found_on_the_search_path(program, bumpy, monkeypatch):
    folder = program("embed", OBJ)
    monkeypatch.setenv("PATH", str(folder), prepend=":")
    map = External([Step(["embed", "mesh.obj", "out.obj"])], "mesh.obj", "out.obj")(bumpy)
    assert map.degree() == 1


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("sys.exit('bad mesh: open')", ["exit code 1", "bad mesh: open"]),
        ("", ["left no spherical map", "was not written"]),
        ("open('sphere.obj', 'w').write('v 1 0 0\\n')", ["1 sound", "642 vertices"]),
        ("open('sphere.obj', 'w').write('v 0 0 0\\n' * 642)", ["0 sound", "of 642"]),
        ("open('sphere.obj', 'w').write('v 1 nan x\\n')", ["cannot be read", "whole obj file"]),
        ("import time; time.sleep(60)", ["ended after 1 seconds", "method.timeout"]),
    ],
)
def test_failing_program_is_told_in_one_line(program, bumpy, body, words):
    folder = program("embed", body)
    method = External([Step(["embed", "mesh.obj"])], "mesh.obj", "sphere.obj", folder, timeout=1.0)
    with pytest.raises(ExternalToolFailed) as caught:
        method(bumpy)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in ["bumpy: embed", *words])


def test_missing_program_names_the_key(tmp_path, bumpy):
    method = External([Step(["SphereMap"])], "mesh.ply", "sphere.ply", tmp_path)
    with pytest.raises(ExternalToolFailed, match=r"SphereMap: not found in .*method.programs="):
        method(bumpy)


def test_file_that_is_no_program_is_told(program, bumpy):
    folder = program("embed", "")
    (folder / "embed").write_bytes(b"\x7fELF nothing")
    with pytest.raises(ExternalToolFailed, match="cannot be run"):
        External([Step(["embed"])], "mesh.obj", "sphere.obj", folder)(bumpy)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_written_meshes_keep_every_digit(suffix, bumpy, tmp_path):
    write_for_program(bumpy, tmp_path / f"mesh.{suffix}")
    again = load_mesh(tmp_path / f"mesh.{suffix}")
    np.testing.assert_array_equal(again.vertices, bumpy.vertices)
    np.testing.assert_array_equal(again.faces, bumpy.faces)


def test_our_own_ply_is_read_back(bumpy, tmp_path):
    sphere = unit(bumpy.vertices)
    save_map(SphericalMap(sphere, bumpy.vertices, bumpy.faces, "bumpy"), tmp_path)
    found = read_sphere_positions(tmp_path / "bumpy.ply", len(sphere))
    np.testing.assert_allclose(found, sphere, rtol=0, atol=1e-15)


def test_other_formats_are_refused(bumpy, tmp_path):
    with pytest.raises(UnreadableMesh, match=r"format '.stl'.*\.ply, \.obj, \.m"):
        write_for_program(bumpy, tmp_path / "mesh.stl")


def test_ply_with_single_positions_colours_and_wide_counts_is_read(bumpy, tmp_path):
    # As MoebiusRegistration writes it: only px, py, pz are doubles.
    sphere = unit(bumpy.vertices)
    fields = [(name, "<f4") for name in "xyz"] + [(f"p{name}", "<f8") for name in "xyz"]
    vertex = np.zeros(len(sphere), [*fields, ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    for k, name in enumerate("xyz"):
        vertex[name], vertex[f"p{name}"] = bumpy.vertices[:, k], sphere[:, k]
    face = np.zeros(len(bumpy.faces), [("count", "<i4"), ("corners", "<i4", (3,))])
    face["count"], face["corners"] = 3, bumpy.faces
    kinds = {"<f4": "float", "<f8": "double", "|u1": "uchar"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertex)}"]
    head += [f"property {kinds[kind]} {name}" for name, kind in vertex.dtype.descr]
    head += [f"element face {len(face)}", "property list int int vertex_indices", "end_header"]
    content = "\n".join(head).encode() + b"\n" + vertex.tobytes() + face.tobytes()
    (tmp_path / "sphere.ply").write_bytes(content)
    found = read_sphere_positions(tmp_path / "sphere.ply", len(sphere))
    np.testing.assert_allclose(found, sphere, rtol=0, atol=1e-15)
