import errno
import os

import numpy as np
import pytest

from gensp.errors import DamagedFile, OutputError
from gensp.files import (
    atomic_path,
    content_hash,
    load_npz,
    read_json,
    read_yaml,
    save_npz,
    write_json,
)


def test_round_trips(tmp_path):
    write_json(tmp_path / "a.json", {"x": np.float64(1.5), "y": np.arange(3)})
    assert read_json(tmp_path / "a.json") == {"x": 1.5, "y": [0, 1, 2]}
    save_npz(tmp_path / "b.npz", values=np.eye(2))
    np.testing.assert_array_equal(load_npz(tmp_path / "b.npz")["values"], np.eye(2))


def test_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    write_json(tmp_path / "a.json", 1)

    def interrupted():
        with atomic_path(tmp_path / "a.json") as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        interrupted()
    assert read_json(tmp_path / "a.json") == 1
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_full_or_read_only_disk_is_one_clear_line(tmp_path, code):

    def write():
        with atomic_path(tmp_path / "a.json"):
            raise OSError(code, os.strerror(code))

    with pytest.raises(OutputError, match=r"a\.json: cannot be written .*paths\.runs"):
        write()
    assert os.listdir(tmp_path) == []


def test_hash_depends_on_content_dtype_and_shape():
    a = np.arange(6.0)
    assert content_hash(a, 1) == content_hash(a.copy(), 1)
    others = [
        content_hash(a, 2),
        content_hash(a.reshape(2, 3), 1),
        content_hash(a.astype("f4"), 1),
    ]
    assert content_hash(a, 1) not in others


def test_values_repeated_by_name_are_refused(tmp_path):
    """Every such line stands for nine times as many texts as that before it."""
    path, line = tmp_path / "a.yaml", "{0}: &{0} [{1}]\n"
    text = "".join(
        line.format(name, ",".join([f"*{old}"] * 9)) for old, name in zip("ab", "bc", strict=True)
    )
    path.write_text("a: &a [x]\n" + text)
    with pytest.raises(DamagedFile, match=r"a\.yaml: is damaged .*repeated by name.*restore"):
        read_yaml(path)
    path.write_text("a: 'b * c'\nd: '*e'\n")
    assert read_yaml(path) == {"a": "b * c", "d": "*e"}
