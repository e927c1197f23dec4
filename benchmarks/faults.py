"""Kill -9 at random moments of every stage, run again, compare with an uninterrupted run.

OMP_NUM_THREADS=1 python benchmarks/faults.py --out faults             # three kills in every stage
OMP_NUM_THREADS=1 python benchmarks/faults.py --stages augment --kills 1 --out faults

A training is killed after it has saved a checkpoint, so that there is something to go on from.
Writes faults.md and faults.csv into the folder, and fails where a result differs by a bit.
"""

import argparse
import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))

from commands import STAGES
from compare import different, results
from test_bad_meshes import DEFECTS

from gensp.data.blobs import BlobFamily, generate_blobs
from gensp.geometry.mesh import Mesh, load_mesh, save_mesh
from gensp.geometry.repair import STEPS
from gensp.layout import item_files
from gensp.runs import CHECKPOINT, MANIFEST, Run

PREPARE = "prepare"
CHOICES = (*STAGES, PREPARE)  # the place of each seeds its moments
TRAININGS = ("implicit", "initialize", "finetune")
_SAY = Console(stderr=True)
_ATTEMPTS = 5  # for every kill: a stage may end before its moment


@dataclass(frozen=True)
class Kill:
    """One kill, and what came of its stage: seconds from the start of the process."""

    stage: str
    seconds: float
    of: float
    found: str
    resumed: str = ""
    files: int = 0
    different: str = ""


@dataclass(frozen=True)
class Study:
    """Two folders of runs: one that is left alone, one whose processes are killed."""

    out: Path
    seed: int

    def words(self, name: str, stage: str, jobs: int) -> list[str]:
        """What is typed; every epoch leaves a checkpoint, so that all states are met."""
        place = self.out / name
        paths = [f"paths.runs={place}", f"paths.cache={place / 'cache'}"]
        small = ["experiment=smoke", "threads=1", "callbacks.last.every_seconds=0"]
        words = [*small, *paths, f"workers.jobs={jobs}", f"stage={stage}"]
        return [*words, *self._raw_words()] if stage == PREPARE else words

    def _raw_words(self) -> list[str]:
        """The raw collection, mended in every way and given new triangles."""
        repair = f"recipe.prepare.repair=[{','.join(STEPS)}]"
        raw = ["shapes=folder", f"shapes.root={self.out / 'raw'}", "name=smoke"]
        return [*raw, repair, "recipe.prepare.remesh=true"]

    def folder(self, name: str, stage: str) -> Path:
        """Where a stage of the experiment writes."""
        return self.out / name / "smoke" / "full" / stage

    def forget(self, stage: str) -> None:
        """Remove the killed stage, and the cache of prepared meshes that would shorten it."""
        shutil.rmtree(self.folder("killed", stage))
        shutil.rmtree(self.out / "killed" / "cache" / "prepared", ignore_errors=True)

    def finish(self, name: str, stage: str) -> tuple[float, float]:
        """Run a stage to its end; seconds of the process, and those after the first checkpoint."""
        began = saved = time.monotonic()
        with self._started(name, stage, 1) as process:
            if stage in TRAININGS:
                self._wait_until_saved(process, self.folder(name, stage) / CHECKPOINT)
                saved = time.monotonic()
            said = process.communicate()[0].decode()
        if process.returncode:
            raise SystemExit(f"stage={stage} ended with {process.returncode}:\n{said[-2000:]}")
        return time.monotonic() - began, time.monotonic() - saved

    def kill(self, stage: str, moment: float, jobs: int) -> tuple[float, str]:
        """Start a stage and kill it with its workers; after how long, what its folder holds then.

        The moment of a training counts from its first checkpoint.
        """
        began = time.monotonic()
        with self._started("killed", stage, jobs) as process:
            if stage in TRAININGS:
                self._wait_until_saved(process, self.folder("killed", stage) / CHECKPOINT)
            try:
                process.wait(timeout=moment)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
        return time.monotonic() - began, self._found(self.folder("killed", stage))

    def _wait_until_saved(self, process: subprocess.Popen[bytes], checkpoint: Path) -> None:
        """Until the process ends, or has saved another checkpoint than one before may have."""
        before = _changed(checkpoint)
        while process.poll() is None and _changed(checkpoint) == before:
            time.sleep(0.005)

    def _started(self, name: str, stage: str, jobs: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "train.py", *self.words(name, stage, jobs)]
        outputs = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        return subprocess.Popen(command, cwd=ROOT, start_new_session=True, **outputs)

    def _found(self, folder: Path) -> str:
        if (folder / MANIFEST).is_file():
            return "finished"
        rows = len(item_files(folder, "rows", ".json"))
        if rows:
            return f"{rows} items"
        if (folder / CHECKPOINT).is_file():
            return "a checkpoint"
        return "its settings" if (folder / "settings.json").is_file() else "nothing"


def _changed(path: Path) -> int:
    return path.stat().st_mtime_ns if path.is_file() else 0


def write_raw(out: Path) -> None:
    """Blobs, every fourth open and every fourth of two parts, and a ball with every defect."""
    family = generate_blobs(out / "cache", BlobFamily(count=12, vertices=1500))
    for k, path in enumerate(sorted(family.rglob("*.ply"))):
        mesh = load_mesh(path)
        vertices, faces = mesh.vertices, mesh.faces
        if k % 4 == 1:
            faces = faces[20:]
        if k % 4 == 2:
            faces = np.concatenate([faces, faces + len(vertices)])
            vertices = np.concatenate([vertices, 0.2 * vertices + 5])
        save_mesh(Mesh(vertices, faces), out / "raw" / path.name)
    for name, (write, *_) in DEFECTS.items():
        if name != "huge":  # takes longer to write than all others to mend
            write(out / "raw" / f"{name}.ply")


def kills_of(study: Study, stage: str, count: int) -> list[Kill]:
    """Kill a stage again and again where it stands, let it end, compare."""
    whole, saving = study.finish("reference", stage)
    working = float(Run(study.folder("reference", stage)).manifest["seconds"])
    random = np.random.default_rng([study.seed, CHOICES.index(stage)])
    kills: list[Kill] = []
    waiting: list[Kill] = []
    for attempt in range(_ATTEMPTS * count):
        # Imports leave nothing that could be spoilt: few kills fall there.
        earliest, latest = 0.9 * (whole - working), whole
        if stage in TRAININGS:
            earliest, latest = 0.0, saving
        moment = float(random.uniform(earliest, latest))
        seconds, found = study.kill(stage, moment, jobs=1 + attempt % 2)
        if found == "finished":  # too late: what was killed before is compared, then anew
            kills += [_compared(study, kill) for kill in waiting]
            waiting.clear()
            study.forget(stage)
            whole, saving = max(0.8 * whole, working), 0.8 * saving  # the machine is less busy
            continue
        waiting.append(Kill(stage, round(seconds, 2), round(whole, 2), found))
        _SAY.print(f"{stage}: killed after {seconds:.1f} s of {whole:.1f} s, left {found}")
        if len(kills) + len(waiting) == count:
            break
    study.finish("killed", stage)
    return [*kills, *(_compared(study, kill) for kill in waiting)]


def _compared(study: Study, kill: Kill) -> Kill:
    ours, theirs = (study.folder(name, kill.stage) for name in ("killed", "reference"))
    resumed = "yes" if Run(ours).manifest["resumed"] else "from the start"
    wrong = ", ".join(different(ours, theirs)) or "none"
    told = {"resumed": resumed, "files": len(results(theirs)), "different": wrong}
    return Kill(**{**asdict(kill), **told})


def markdown(kills: Sequence[Kill]) -> str:
    """The table, a line for each kill."""
    lines = [
        "| stage | killed after (s) | of (s) | left | resumed | files compared | different |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [f"| {' | '.join(str(value) for value in asdict(kill).values())} |" for kill in kills]
    return "\n".join(lines)


def main() -> None:
    """Kill, compare, write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=3, help="in every stage")
    parser.add_argument("--stages", nargs="+", default=CHOICES, choices=CHOICES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    study = Study(chosen.out.resolve(), chosen.seed)
    if PREPARE in chosen.stages:
        write_raw(study.out)
    kills = [kill for stage in chosen.stages for kill in kills_of(study, stage, chosen.kills)]
    chosen.out.mkdir(parents=True, exist_ok=True)
    with open(chosen.out / "faults.csv", "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(Kill.__dataclass_fields__))
        writer.writeheader()
        writer.writerows(asdict(kill) for kill in kills)
    (chosen.out / "faults.md").write_text(markdown(kills) + "\n", encoding="utf-8")
    Console(width=200).print(markdown(kills), markup=False, highlight=False, soft_wrap=True)
    spoilt = [kill for kill in kills if kill.different != "none"]
    if spoilt:
        raise SystemExit(f"{len(spoilt)} of {len(kills)} kills: a result differs")


if __name__ == "__main__":
    main()
