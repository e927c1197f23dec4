import json

from gensp.comparison import baselines, compare_variants
from gensp.files import write_json


def summary(variant: str, sigma: float) -> dict:
    group = {"shapes": 2, "sigma_mean": sigma, "error": sigma / 100, "bad_faces": 0}
    names = {"experiment": "e", "variant": variant, "method": "gensp", "collection": "heads"}
    return {**names, "groups": {"test": group}, "skipped": [], "failed": []}


def test_variants_stand_side_by_side_in_the_papers_order(tmp_path):
    for variant, sigma in (("cmcf", 3.0), ("no_gr", 2.0), ("full+register", 1.25), ("full", 1.5)):
        folder = tmp_path / variant / "evaluate"
        folder.mkdir(parents=True)
        (folder / "summary.json").write_text(json.dumps(summary(variant, sigma)))
    comparison = compare_variants(tmp_path)
    found = [found["variant"] for found in comparison.summaries]
    assert found == ["full", "full+register", "no_gr", "cmcf"]
    text = (tmp_path / "summary.md").read_text()
    assert text.index("1.5") < text.index("1.25") < text.index("3.0")
    assert (tmp_path / "summary.csv").is_file()


def test_an_experiment_without_tables_writes_none(tmp_path):
    assert compare_variants(tmp_path).summaries == ()
    assert list(tmp_path.iterdir()) == []


def evaluated(root, variant: str, error: float | None, *, bad: int = 0, method: str = "") -> None:
    group = {"sigma_mean": 2.0, "affected_shapes": bad}
    group |= {} if error is None else {"error": error}
    names = {"variant": variant, "method": method or variant}
    write_json(root / variant / "evaluate" / "summary.json", {**names, "groups": {"all": group}})


def test_the_best_baselines_learn_nothing_and_fold_nothing(tmp_path):
    evaluated(tmp_path, "full", 0.01, method="gensp")
    evaluated(tmp_path, "arap", 0.02, bad=1)
    for variant, error in (("ahsp", 0.04), ("cmcf", 0.05), ("stretch", 0.03)):
        evaluated(tmp_path, variant, error)
    maps = {name: tmp_path / name / "parameterize" for name in ("ahsp", "cmcf", "stretch")}
    found = baselines(tmp_path, besides=tmp_path / "full" / "parameterize", count=2)
    assert list(found.items()) == [("stretch", maps["stretch"]), ("ahsp", maps["ahsp"])]
    others = baselines(tmp_path, besides=maps["stretch"], count=2)
    assert list(others) == ["ahsp", "cmcf"]


def test_without_ground_truth_the_least_distorted_are_the_best(tmp_path):
    for variant, sigma in (("a", 3.0), ("b", 1.0), ("c", 2.0)):
        group = {"sigma_mean": sigma, "affected_shapes": 0}
        found = {"variant": variant, "method": variant, "groups": {"all": group}}
        write_json(tmp_path / variant / "evaluate" / "summary.json", found)
    assert list(baselines(tmp_path, besides=tmp_path, count=2)) == ["b", "c"]
