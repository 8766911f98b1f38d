"""`bike validate --course`, as a shell calls it."""

import json

import pytest

from bike_training import cli


@pytest.fixture
def ring(tmp_path, shapes):
    path = tmp_path / "ring.csv"
    path.write_text(shapes.csv_text(shapes.ring_points(160, 80.0, 0.2, 3), 4.0, 5.0))
    return path


def test_sound_file_passes_with_its_figures(ring, capsys):
    assert cli.main(["validate", "--course", str(ring), "--json"]) == 0
    out = capsys.readouterr().out
    result = json.loads(out)
    figures = result["figures"]
    assert result["schema"] == "bike.validate_course/1"
    assert result["ok"] is True
    assert figures["length_m"] == pytest.approx(555.0, rel=0.1)
    assert (figures["width_min_m"], figures["width_max_m"]) == pytest.approx((9.0, 9.0))
    assert figures["direction"] == "counter-clockwise"
    assert figures["ideal_lap_s"] < figures["median_lap_s"]


def test_broken_file_is_one_line_on_standard_error(ring, capsys):
    ring.write_text(ring.read_text().replace("4.0,5.0", "4.0,nan", 1))
    assert cli.main(["validate", "--course", str(ring), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "row 2" in err
    assert "w_tr_left_m" in err


def test_missing_file_is_named(tmp_path, capsys):
    assert cli.main(["validate", "--course", str(tmp_path / "nowhere.csv")]) == 2
    assert "nowhere.csv" in capsys.readouterr().err


def test_plot_is_a_picture(ring, tmp_path, capsys):
    assert cli.main(["validate", "--course", str(ring), "--out", str(tmp_path / "pictures")]) == 0
    picture = (tmp_path / "pictures" / "ring.png").read_bytes()
    assert picture[:4] == b"\x89PNG"
    assert len(picture) > 20_000
    assert "a sound circuit" in capsys.readouterr().out
