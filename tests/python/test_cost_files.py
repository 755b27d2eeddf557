# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables, figure and images of a measurement, and references from files."""

import csv
import io
import struct
import sys

import numpy as np
import pytest
from amberlight.binding.errors import AmberlightError
from amberlight.cost import exr, output, tables
from amberlight.cost.references import load_reference
from amberlight.cost.rows import Missing
from amberlight.cost.scenes import image_size
from cost_stub import SIZE, TRUTH, make_row, measurement

ROWS = [
    make_row("POINTS_FIXED", 1.0, 0.2, light_samples=8192, kernel_size=4.0),
    make_row("POINTS_FIXED", 4.0, 0.05, light_samples=32768, kernel_size=4.0),
    make_row("POINTS_FIXED", 4.5, 0.06, light_samples=32768, kernel_size=8.0),
    make_row("TUBES", 0.5, 0.01, tube_refinement=0),
    make_row("TUBES", 2.0, 0.0015, tube_refinement=1),
]
MISSING = [Missing("SPECULAR", "cannot render this: too dark")]


def table_rows(text, heading):
    """Cells of the table below a heading: {first cell: [cells]}."""
    part = text.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert len({len(line) for line in cells}) == 1
    return {line[0]: line for line in cells[2:]}, cells[0]


def test_csv():
    lines = list(csv.DictReader(io.StringIO(tables.csv_text(measurement(ROWS)))))
    assert [line["estimator"] for line in lines] == [r.setting.estimator for r in ROWS]
    first, last = lines[0], lines[-1]
    assert (first["light_samples"], first["kernel_size"], first["tube_refinement"]) == (
        "8192", "4.0", "",
    )  # fmt: skip
    assert (last["light_samples"], last["tube_refinement"]) == ("", "1")
    assert float(first["mse"]) == pytest.approx(0.04) and first["rel_rmse"] == "0.2"
    assert (first["precompute_cpu_s"], first["camera_cpu_s"]) == ("0.500000", "0.500000")
    # The median of the camera rays is 0.1 s.
    assert float(first["over_camera_rays"]) == pytest.approx(10.0)
    assert [line["on_front"] for line in lines] == ["1", "1", "0", "1", "1"]


def test_markdown():
    text = tables.markdown_text(measurement(ROWS, missing=MISSING, notes=["mind the gap"]))
    assert "- mind the gap\n" in text and "- SPECULAR: cannot render this: too dark\n" in text
    rows, header = table_rows(text, "Rows")
    assert header[:4] == ["estimator", "samples", "setting", "MB"]
    # The reference's own error is 0.1 %, the finest row's 0.15 %.
    assert set(rows) == {"POINTS_FIXED *", "POINTS_FIXED", "TUBES *", "TUBES *?"}
    assert rows["TUBES *?"][header.index("rel_rmse")] == "0.15 %"

    equal, header = table_rows(text, "Equal error: 5 % rel_rmse")
    assert equal["POINTS_FIXED"][header.index("times cheaper")] == "1"
    assert equal["TUBES"][header.index("times cheaper")] == "8"
    assert equal["TUBES"][-1] == "the cheapest setting: refinement 0"
    equal, header = table_rows(text, "Equal time: 2 CPU s")
    # 1 s to 4 s, 20 % to 5 %: half way is 10 %.
    assert equal["POINTS_FIXED"][header.index("rel_rmse")] == "10 %"
    assert equal["TUBES"][header.index("times more accurate")] == "66.7"


def test_targets_that_nobody_reaches():
    text = tables.markdown_text(measurement(ROWS, wanted_error=0.001, wanted_time=0.75))
    equal, _ = table_rows(text, "Equal error: 0.1 % rel_rmse")
    assert equal["TUBES"][-1] == "not reached: the best is 0.15 %"
    equal, header = table_rows(text, "Equal time: 0.75 CPU s")
    assert equal["POINTS_FIXED"][-1] == "not reached: the cheapest takes 1 s"
    assert equal["TUBES"][header.index("times more accurate")] == ""


def test_shown_rows_are_the_nearest_to_equal_time():
    shown = output.shown_rows(measurement(ROWS))
    assert shown == {"POINTS_FIXED": ROWS[0], "TUBES": ROWS[4]} or shown == {
        "POINTS_FIXED": ROWS[1], "TUBES": ROWS[4],
    }  # fmt: skip


def png_size(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


@pytest.mark.parametrize("rows", [ROWS, ROWS[:3], ROWS[:1]], ids=["two", "one", "single row"])
def test_figure(tmp_path, rows):
    pytest.importorskip("matplotlib")
    files, said = output.write_all(measurement(rows), tmp_path)
    assert said == "" and tmp_path / "cost.png" in files
    width, height = png_size(tmp_path / "cost.png")
    assert width > 1000 and height > 800
    # Pyplot would be global, and might look for a display.
    assert "matplotlib.pyplot" not in sys.modules


def test_figure_of_four_estimators_and_answers_that_are_missing(tmp_path):
    pytest.importorskip("matplotlib")
    more = [
        make_row("POINTS_COVARIANCE", 2.0, 0.1, light_samples=8192, kernel_size=1.0),
        make_row("SPECULAR", 900.0, 1e-4),
    ]
    found = measurement(ROWS + more, wanted_error=0.001, wanted_time=3.0)
    files, said = output.write_all(found, tmp_path)
    assert said == "" and len(files) == 3 + 1 + 4


def test_without_matplotlib(tmp_path, monkeypatch):
    (tmp_path / "cost.png").write_text("of an earlier measurement")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    files, said = output.write_all(measurement(ROWS), tmp_path)
    assert "no matplotlib, install python3-matplotlib" in said
    assert {file.name for file in files} == {
        "cost.csv", "cost.md", "cost_reference.exr", "cost_points_fixed.exr", "cost_tubes.exr",
    }  # fmt: skip
    assert {path.name for path in tmp_path.iterdir()} == {file.name for file in files}


def test_difference_in_the_images(tmp_path):
    output.write_all(measurement(ROWS), tmp_path)
    channels = exr.read(tmp_path / "cost_tubes.exr")
    assert channels["Difference x5.G"] == pytest.approx(np.full((SIZE, SIZE), 0.05), rel=1e-4)


# ---- OpenEXR -------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [1, 16, 37])
def test_exr_there_and_back(tmp_path, height):
    rng = np.random.default_rng(1)
    layers = {
        "Noise": rng.random((height, 21, 3), np.float32),
        "Flat colour of a name that is longer": np.full((height, 21, 3), 0.25, np.float32),
    }
    exr.write(tmp_path / "a.exr", layers)
    channels = exr.read(tmp_path / "a.exr")
    assert sorted(channels) == sorted(f"{name}.{c}" for name in layers for c in "RGB")
    for name, pixels in layers.items():
        for index, letter in enumerate("RGB"):
            assert np.array_equal(channels[f"{name}.{letter}"], pixels[..., index])


def test_exr_of_something_else(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"\x89PNG and more")
    with pytest.raises(exr.ExrError, match="is not an OpenEXR file"):
        exr.read(tmp_path / "a.exr")
    exr.write(tmp_path / "b.exr", {"A": TRUTH})
    data = (tmp_path / "b.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(data[: len(data) // 2])
    with pytest.raises(exr.ExrError, match="damaged|b.exr"):
        exr.read(tmp_path / "b.exr")


# ---- References ----------------------------------------------------------------------------------


def ramp():
    """Row 0 at the top is 0."""
    return np.repeat(np.arange(8.0)[:, None, None], 4, axis=1) * np.ones(3)


def test_reference_arrays_begin_at_the_top(tmp_path):
    np.save(tmp_path / "a.npy", ramp())
    found = load_reference(tmp_path / "a.npy")
    assert found.size == (4, 8) and found.images[0][0, 0, 0] == 7.0


def test_reference_exr_prefers_what_estimators_differ_in(tmp_path):
    exr.write(tmp_path / "a.exr", {
        "ViewLayer.Combined": TRUTH, "ViewLayer.Single Scattering": TRUTH / 2,
    })  # fmt: skip
    assert load_reference(tmp_path / "a.exr").images[0].mean() == 1.0


@pytest.mark.parametrize("given", ["case", "case/case.json"])
def test_reference_case(tmp_path, given):
    folder = tmp_path / "case"
    folder.mkdir()
    (folder / "case.json").write_text("{}")
    for name in "AB":
        np.save(folder / f"ref_128_{name}.npy", ramp())
    found = load_reference(tmp_path / given)
    assert len(found.images) == 2 and found.name == "case case, ref_128_A.npy and ref_128_B.npy"
    np.save(folder / "analytic_128.npy", ramp())
    assert len(load_reference(tmp_path / given).images) == 1


def test_bad_references(tmp_path):
    np.save(tmp_path / "flat.npy", np.zeros((4, 4)))
    np.save(tmp_path / "broken.npy", np.full((4, 4, 3), np.nan))
    (tmp_path / "empty").mkdir()
    for name, words in [
        ("flat.npy", "three finite channels"),
        ("broken.npy", "three finite channels"),
        ("nowhere.npy", "cannot be read"),
        ("picture.png", "is not an .npy array, an .exr image"),
        ("empty", "has no analytic"),
    ]:
        with pytest.raises(AmberlightError, match=words):
            load_reference(tmp_path / name)


def test_image_size(tmp_path):
    assert image_size((1920, 1080), 256, None) == (256, 144)
    assert image_size((100, 50), 256, None) == (100, 50)
    assert image_size((1000, 2000), 0, None) == (1000, 2000)
    np.save(tmp_path / "a.npy", ramp())
    given = load_reference(tmp_path / "a.npy")
    assert image_size((200, 400), 256, given) == (4, 8)
    with pytest.raises(AmberlightError, match="another shape than the scene's 400 x 400"):
        image_size((400, 400), 256, given)
