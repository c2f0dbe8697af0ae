"""What is downloaded is what is seen: each chart's CSV has the figure's numbers, each PNG is the chart on white."""

import base64
import csv
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.browser

SINGLE = 1e-6  # figures are sent in single precision
UNITS = {"f_m": 1e3, "b4_per_m4": 1e-8, "a1_rad": 1e3, "a2_rad": 1e3}
SMALLEST_BAR = 0.1
PARTS = {
    "parameters": "result",
    "correlation": "result",
    "convergence": "convergence",
    "rms": "convergence",
    "distortion": "distortion",
    "radial": "distortion",
    "coverage": "distortion",
    "observability": "observability",
}
PIXELS = """async ([address]) => {
    const image = new Image();
    image.src = address;
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    pen.drawImage(image, 0, 0);
    const at = (x, y) => [...pen.getImageData(x, y, 1, 1).data];
    const [right, low] = [image.width - 1, image.height - 1];
    const all = pen.getImageData(0, 0, image.width, image.height).data;
    let inked = 0;
    for (let k = 0; k < all.length; k += 4) inked += all[k] + all[k + 1] + all[k + 2] < 600;
    return { width: image.width, height: image.height, corners: [at(0, 0), at(right, 0), at(0, low), at(right, low)], inked };
}"""


class RunPage:
    def __init__(self, window, run_id):
        self.window, self.run_id, self.part = window, run_id, None

    def figure(self, name):
        if self.part != PARTS[name]:
            self.part = PARTS[name]
            self.window.open(f"/runs/{self.run_id}?part={self.part}")
            self.window.unfold()
        return self.window.figure(name)

    def csv(self, name):
        return columns(download(self.window, self.figure(name), "CSV"))

    def drawn(self, name):
        self.figure(name)
        return self.window.drawn(name)


@pytest.fixture(scope="module")
def run_page(people, sequential_run):
    with people.seat("analyst") as window:
        yield RunPage(window, sequential_run)


@pytest.fixture(scope="module")
def initial(run_page, sequential_run):
    return run_page.window.result(sequential_run)["initial"]


def download(window, panel, kind: str) -> Path:
    with window.page.expect_download() as coming:
        panel.locator("header").get_by_text(kind, exact=False).first.click()
    assert coming.value.suggested_filename.endswith(kind.lower())
    return coming.value.path()


def columns(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, zip(*rows, strict=True), strict=True))


def floats(cells) -> np.ndarray:
    return np.array([float(cell) if cell else np.nan for cell in cells])


def close(drawn, expected):
    scale = float(np.nanmax(np.abs(expected)))
    assert np.array(drawn, float) == pytest.approx(expected, rel=SINGLE, abs=SINGLE * scale, nan_ok=True)


def test_the_csv_of_convergence_has_the_curves_and_their_bands(run_page, initial):
    table = run_page.csv("convergence")
    drawn = run_page.drawn("convergence")
    for place, (name, start) in enumerate(initial.items()):
        band, line = drawn[2 * place : 2 * place + 2]
        value = (floats(table[name]) - start) * UNITS.get(name, 1.0)
        reach = 3 * floats(table[f"sigma_{name}"]) * UNITS.get(name, 1.0)
        assert line["x"] == floats(table["frame"]).tolist()
        close(line["y"], value)
        close(sorted(band["y"]), np.sort(np.concatenate([value - reach, value + reach])))


def test_the_csv_of_rms_has_tail_and_aggregate(run_page):
    table = run_page.csv("rms")
    curves = {one["name"].rpartition(" · ")[2]: one for one in reversed(run_page.drawn("rms"))}
    for word in ("tail", "aggregate"):
        assert curves[word]["x"] == floats(table["frame"]).tolist()
        close(curves[word]["y"], 1e6 * floats(table[f"{word}_rms_rad"]))


def test_the_csv_of_the_radial_difference_has_the_curve_and_its_band(run_page):
    table = run_page.csv("radial")
    line, band = run_page.drawn("radial")[:2]
    value, reach = floats(table["difference_px"]), 3 * floats(table["sigma_px"])
    close(line["x"], floats(table["radius_px"]))
    close(line["y"], value)
    close(sorted(band["y"]), np.sort(np.concatenate([-reach, reach])))


def test_the_csv_of_observability_has_the_bars_and_the_directions(run_page, initial):
    table = run_page.csv("observability")
    bars, *others = run_page.drawn("observability")
    (directions,) = [trace for trace in others if trace.get("z")]
    close(bars["y"], floats(table["singular_value"]))
    close(bars["customdata"], floats(table["sigma_of_direction"]))
    close(directions["z"], np.array([floats(table[name]) for name in initial]))


@pytest.mark.full
def test_the_csv_of_coverage_has_every_cell(run_page):
    table = run_page.csv("coverage")
    (cells,) = run_page.drawn("coverage")
    assert [count or 0 for row in cells["z"] for count in row] == floats(table["stars"]).tolist()


def test_the_csv_of_parameter_changes_has_bars_and_points(run_page, initial):
    table = run_page.csv("parameters")
    bars, points = run_page.drawn("parameters")
    assert list(table["parameter"]) == list(initial)
    close(bars["x"], np.maximum(np.abs(floats(table["delta_over_sigma"])), SMALLEST_BAR))
    close(points["x"], floats(table["delta_in_typical_sigma"]))


def test_the_csv_of_the_distortion_has_both_curves(run_page):
    table = run_page.csv("distortion")
    _, new, old = run_page.drawn("distortion")[:3]
    close(new["y"], floats(table["new_px"]))
    close(old["y"], floats(table["old_px"]))


@pytest.mark.full
def test_the_csv_of_correlations_has_every_pair_once(run_page, initial):
    table = run_page.csv("correlation")
    (cells,) = run_page.drawn("correlation")
    drawn = np.array(cells["z"], float)[np.triu_indices(len(initial), 1)]
    apart = np.array(table["parameter"]) != np.array(table["with"])
    close(drawn, floats(table["correlation"])[apart])


@pytest.mark.parametrize(
    "name", [name if name == "convergence" else pytest.param(name, marks=pytest.mark.full) for name in PARTS]
)
def test_the_png_of_a_figure_is_the_chart_on_white(run_page, name):
    on_white(run_page.window, download(run_page.window, run_page.figure(name), "PNG"))


def test_the_drawings_of_a_telemetry_set_are_saved_alike(people, telemetry):
    with people.seat("analyst") as window:
        window.open(f"/telemetry/{telemetry['calibration']}")
        panels = window.page.locator("section.drawing")
        assert panels.count() >= 4
        for panel in panels.all():
            on_white(window, download(window, panel, "PNG"))
            table = columns(download(window, panel, "CSV"))
            counted = floats(list(table.values())[-1]).sum()
            shown = panel.locator("td.num").all_text_contents()
            assert counted == sum(int(cell.replace("\u202f", "")) for cell in shown)


def on_white(window, path: Path) -> None:
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    address = f"data:image/png;base64,{base64.b64encode(content).decode()}"
    seen = window.page.evaluate(PIXELS, [address])
    assert seen["corners"] == [[255, 255, 255, 255]] * 4
    assert 1e-3 * seen["width"] * seen["height"] < seen["inked"] < 0.6 * seen["width"] * seen["height"]
