"""Where the files of an item lie: side by side, or those of many items in many folders.

`FOLDER/maps/<id>.npz` while a stage has few items, `FOLDER/maps/3f/<id>.npz` beyond: so begins
the SHA-256 of the id. `layout.json`, which is written before the first item, tells how many
digits there are: writers, readers and a resumed run look there. A folder without it has none.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

from gensp.errors import DamagedFile
from gensp.files import read_json, write_json

LAYOUT = "layout.json"

# So many items lie in one folder: a listing of so many is still read at once, and the folders that
# are copied, shown or kept on common file systems are not slowed by it.
MOST = 4096


def lay_out(folder: Path, items: int) -> None:
    """Decide where the items of a folder lie, before the first is written; what is decided stays.

    Parameters
    ----------
    items
        Of all ranks, or more.
    """
    decided = (folder / LAYOUT).is_file() or (folder / "rows").is_dir()
    if items > MOST and not decided:
        write_json(folder / LAYOUT, {"digits": digits_for(items)})


def digits_for(items: int) -> int:
    """The fewest digits with which a folder has a quarter of `MOST` on average.

    An item may have several files of a kind: a map two, a shape its samples. A million items have
    three digits: 4,096 folders of 244 items.
    """
    digits = 0
    while 4 * items > MOST * 16**digits:
        digits += 1
    return digits


def item_folder(folder: Path, kind: str, item: str) -> Path:
    """Where the files of an item lie: those of one kind, such as "maps"; "." is the folder itself.

    Raises
    ------
    DamagedFile
        What tells the layout is damaged.
    """
    digits = _digits(folder)
    digest = hashlib.sha256(item.encode("utf-8", "surrogateescape")).hexdigest()
    return folder / kind / digest[:digits]


def item_file(folder: Path, kind: str, item: str, end: str = ".npz") -> Path:
    """The file of one kind that an item has; see `item_folder`."""
    return item_folder(folder, kind, item) / f"{item}{end}"


def item_files(folder: Path, kind: str, end: str) -> list[Path]:
    """The files of all items of one kind, by name, whatever the layout."""
    digits = _digits(folder)
    # Names with a dot in front are halves that a killed run left.
    found = (folder / kind).glob("?" * digits + "/" * bool(digits) + f"[!.]*{end}")
    return sorted(found, key=lambda path: path.name)


def _digits(folder: Path) -> int:
    path = folder / LAYOUT
    try:
        written = path.stat().st_mtime_ns
    except (FileNotFoundError, NotADirectoryError):
        return 0
    return _stored_digits(path, written)


# Asked for with every file; read again when it was written again.
@lru_cache(maxsize=64)
def _stored_digits(path: Path, written: int) -> int:
    found = read_json(path)
    digits = found.get("digits") if isinstance(found, dict) else None
    if not isinstance(digits, int) or not 1 <= digits <= 8:
        raise DamagedFile(
            f"{path}: is damaged (tells no number of digits); where the files of the items lie is "
            "required; restore it, or make the stage anew with force=true"
        )
    return digits


def keyed_path(folder: Path, key: str, end: str) -> Path:
    """Where a cache keeps what a hexadecimal key names: below its first two digits.

    What was kept before there were folders is found where it lies.
    """
    before = folder / f"{key}{end}"
    return before if before.is_file() else folder / key[:2] / before.name
