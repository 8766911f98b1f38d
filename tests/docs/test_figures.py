"""Tables of documents are those of their data, and each data file says by which command it was made."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))
import baselines  # noqa: E402
import figures  # noqa: E402
import measure  # noqa: E402

HEADS = list(figures.data_heads())


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda page: page.stem)
def test_tables_of_pages_are_those_of_the_data(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- figures:") == text.count("<!-- /figures -->") == len(figures.BLOCK.findall(text))
    assert figures.filled(text) == text, "run make figures"


@pytest.mark.parametrize("path", HEADS, ids=lambda path: str(path.relative_to(figures.DATA)))
def test_heads_name_commands_that_can_be_given(path: Path, check_command: Callable[[str], None]) -> None:
    head = figures.read_head(path)
    assert re.fullmatch(r"[0-9a-f]{7,}", head["commit"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", head["date"])
    program, script, *_ = head["command"].split()
    if program == "python":
        assert (ROOT / script).is_file()
    else:
        check_command(head["command"])


def test_every_table_is_shown_somewhere() -> None:
    """What no page shows or links to is no longer needed."""
    pages = "".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    for path in HEADS:
        name = path.parent.name if path.name == "head.txt" else path.stem
        assert re.search(rf"<!-- figures: \w+ (?:[\w,]+,)?{name}\b|data/{name}\b", pages), name


def test_a_table_that_is_changed_by_hand_is_found() -> None:
    page = next(page for page in figures.PAGES if "<!-- figures: shipped" in page.read_text(encoding="utf-8"))
    text = page.read_text(encoding="utf-8")
    row = re.search(r"<!-- figures: shipped.*?\n\n(?:\|.*\n){2}(\|.*\n)", text)
    assert row is not None
    assert figures.filled(text.replace(row[1], "| 0 |\n")) == text


def test_data_older_than_its_sources_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    head = figures.read_head(HEADS[0])
    monkeypatch.setattr(figures, "changed_sources", lambda head: ["physics"])
    line = " ".join(figures.origin(HEADS[0]).split())
    assert f"Measured at commit {head['commit']} ({head['date']}); changed since: physics" in line
    monkeypatch.undo()
    assert figures.changed_sources({**head, "commit": "HEAD"}) == []
    assert figures.changed_sources({**head, "commit": "0000000"}) == [], "a shallow clone"


def test_a_head_without_an_entry_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# command: bike ride\n# depends: weather\nx\n1\n")
    with pytest.raises(ValueError, match=r"lacks \['commit', 'date', 'machine'\].*\['weather'\]"):
        figures.read_head(tmp_path / "a.csv")


@pytest.mark.parametrize("name", measure.TABLES)
def test_data_can_be_measured_anew(name: str, check_command: Callable[[str], None]) -> None:
    for variant in measure.TABLES[name].variants:
        check_command(f"bike {' '.join(measure.words_of(name, variant))}")


def test_rows_of_answers_are_those_of_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is written can be read, with the commit that last changed its sources, and is not out of date."""
    monkeypatch.setattr(measure, "DATA", tmp_path)
    for module in (figures, measure):  # sources that nobody is at work on
        monkeypatch.setattr(module, "SOURCES", dict.fromkeys(figures.SOURCES, ("LICENSE",)))
    head = (figures.DATA / "racer_pairs.csv").read_text(encoding="utf-8").partition("vehicle,")[0]
    (tmp_path / "racer_pairs.csv").write_text(head)
    measure.write("racer_pairs", [({"figures": {"races": [{"vehicle": "r1", "best_s": None}]}}, 3.0)])
    lines = (tmp_path / "racer_pairs.csv").read_text(encoding="utf-8").splitlines()
    assert lines[-3:] == ["# duration: 3 s", "vehicle,best_s", "r1,"]
    assert figures.changed_sources(figures.read_head(tmp_path / "racer_pairs.csv")) == []


def test_baselines_learn_what_their_table_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tmp_path / "benchmark_baselines.csv"
    lines = (figures.DATA / table.name).read_text(encoding="utf-8").splitlines(True)
    table.write_text(
        "".join([line for line in lines if line.startswith("#")] + ["task,learner,vehicles,"])
        + "decisions,seed,error,failed,score,processor_s\n"
    )
    learned, faults = [], []

    def learn(*settings: object) -> list[dict[str, float]]:
        learned.append(settings[5])
        common = {"failed": 0, "processor_s": 1.0}
        return [
            {"decisions": 50, "error": 0.2, "score": 0.0} | common,
            {"decisions": 99, "error": 0.1, "score": 0.5} | common,
        ]

    for module in (figures, baselines):
        monkeypatch.setattr(module, "DATA", tmp_path)
    monkeypatch.setattr(baselines, "PICTURE", tmp_path / "curves.png")
    monkeypatch.setattr(baselines, "STEPS", 99)
    monkeypatch.setattr(baselines, "changed_sources", lambda head: [])
    monkeypatch.setattr(baselines, "verify_results", lambda path: {"faults": faults})
    monkeypatch.setattr(baselines, "runpy", SimpleNamespace(run_path=lambda path: {"learn": learn}))
    words = ["baselines.py", "--id", "two_wheeler/Path-v0", "--learner", "sbx TD3", "--seeds"]
    for seeds in ("2", "3"):
        monkeypatch.setattr(sys, "argv", [*words, seeds])
        baselines.main()
    assert learned == [0, 1, 2]
    written = figures.baselines(table.stem)
    assert "| sbx TD3 | 99 | 3 | 0.100 (0.100 to 0.100) | 0.500 (0.500 to 0.500) | 0.0 | 1 s |" in written
    assert "0.200" not in written, "the table has the end of a curve"
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    faults.append("episode 1")
    monkeypatch.setattr(sys, "argv", [*words, "4"])
    with pytest.raises(RuntimeError, match="episode 1"):
        baselines.main()
    assert len(figures.read_records(table.stem)) == 6, "a score that is not true has no row"
