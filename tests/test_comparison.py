import json

from gensp.comparison import compare_variants


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
