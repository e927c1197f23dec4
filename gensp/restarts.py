"""How far a run of some settings has come in a folder, and what may be done with the folder."""

import shutil
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from gensp.checksums import MANIFEST
from gensp.errors import OutputError, StaleRun
from gensp.files import write_json
from gensp.runs import LOCK, SETTINGS, plain, record

_MESHES = "shapes: the meshes of the collection, or their ground truth or splits, have changed"


class Progress(Enum):
    """What a folder holds of the run that is asked for."""

    NOTHING = "nothing"
    SOME = "some"
    ALL = "all"


def restart(folder: Path, settings: Mapping[str, Any]) -> Progress:
    """How far a run of these settings has come in this folder.

    Parameters
    ----------
    settings
        Its entry `inputs` holds the digests of the results that the run reads, by stage.

    Raises
    ------
    StaleRun
        The folder holds a run, finished or not, of other settings or of other inputs.
    """
    sealed = folder / MANIFEST
    found = sealed if sealed.is_file() else folder / SETTINGS
    if not found.is_file():
        return Progress.NOTHING
    stored, asked = dict(record(found, {"settings"})["settings"]), plain(settings)
    before, now = stored.pop("inputs", None) or {}, asked.pop("inputs", None) or {}
    changed = differences(stored, asked)
    if changed:
        # A fingerprint against a fingerprint tells nothing to a person.
        changed = [_MESHES if line.startswith("shapes: ") else line for line in changed]
        listed = "; ".join(changed[:6]) + (f"; and {len(changed) - 6} more" * (len(changed) > 6))
        raise StaleRun(
            f"{folder}: made with other settings ({listed}); the same settings are required to go "
            f"on; add force=true to make it anew, or {_elsewhere(asked)} to keep both"
        )
    remade = [stage for stage in sorted({*before, *now}) if before.get(stage) != now.get(stage)]
    if remade:
        raise StaleRun(
            f"{folder}: made from other results of stage {', '.join(remade)} than there are now; "
            "a stage and what it reads must belong together; make it anew from them with "
            f"stage={asked['stage']['name']} force=true, or {_elsewhere(asked)} to keep both"
        )
    return Progress.ALL if found is sealed else Progress.SOME


def _elsewhere(asked: Mapping[str, Any]) -> str:
    """The word that sends a stage to another folder."""
    prepare = (asked.get("stage") or {}).get("name") == "prepare"
    return "prepare.out=NEW" if prepare else "name=NEW"


def require_own(folder: Path, stage: str) -> None:
    """Refuse to write into a folder that holds something else than this stage's results.

    Raises
    ------
    OutputError
        It is a file, or holds files that no run of the stage has left.
    """
    if folder.is_dir() and _content(folder):
        notes = [path for path in (folder / MANIFEST, folder / SETTINGS) if path.is_file()]
        found = record(notes[0], {"settings"})["settings"] if notes else {}
        if (found.get("stage") or {}).get("name") == stage:
            return
    elif not folder.exists() or folder.is_dir():
        return
    raise OutputError(
        f"{folder}: is not empty and was not written by stage={stage}; a folder of its own is "
        "required, because it may be cleared; name one that does not exist yet"
    )


def begin(folder: Path, settings: Mapping[str, Any]) -> None:
    """Note what a run is made with, before its first result."""
    write_json(folder / SETTINGS, {"settings": plain(settings)})


def tidy(folder: Path) -> None:
    """Remove the halves of files that a killed run left; see `gensp.files.atomic_path`."""
    for path in folder.rglob(".*-*"):
        if path.is_file():
            path.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Empty a run's folder; its seal first, so that a half-removed run never looks finished.

    Its lock stays: whoever holds it keeps holding it.
    """
    (folder / MANIFEST).unlink(missing_ok=True)
    for path in _content(folder) if folder.is_dir() else ():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _content(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name != LOCK]


def differences(old: Any, new: Any, key: str = "") -> list[str]:
    """Which entries of two nested settings differ, as "key: old → new"."""
    if isinstance(old, dict) and isinstance(new, dict):
        names = [*old, *(name for name in new if name not in old)]
        pairs = ((name, old.get(name), new.get(name)) for name in names)
        return [
            line
            for name, a, b in pairs
            for line in differences(a, b, f"{key}.{name}" if key else str(name))
        ]
    return [] if old == new else [f"{key}: {_short(old)} → {_short(new)}"]


def _short(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
