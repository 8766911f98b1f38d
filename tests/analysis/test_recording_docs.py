"""docs/reference/recording.md: the readers it shows open a recording."""

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "recording.md").read_text(encoding="utf-8")


def test_its_readers_read_every_state(writer, circle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    ride = circle(steps=50, offset=0.25)
    writer.write(tmp_path / "out" / "ride.mcap", [ride], metadata_file=False)
    writer.write(tmp_path / "out" / "tour", [ride])
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        exec(compile(block, "docs/reference/recording.md", "exec"), {})
        lines = capsys.readouterr().out.splitlines()
        assert [float(line.split()[1]) for line in lines] == [0.25] * 50
