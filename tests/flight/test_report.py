"""The report of a mission: what it says against the log, and how it looks in a browser."""

import base64
import gzip
import json
import re
import shutil
import subprocess
import tempfile
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from drivers import records
from onboard import cli, config
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.ground.drawing import theme, zoom
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.identify.mission.own_mission import with_quantities
from onboard.ground.log.tables import truth
from onboard.ground.log.tables.phases import Phase
from onboard.ground.report import report
from onboard.ground.report.flight.alone import alone
from onboard.ground.report.flight.flight_data import SweepData
from tests.flight.missions import Result
from tests.recording.logs import make_log

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SECTIONS = [
    "Answers", "Timeline", "Encoder and load cell", "Accelerations and rates", "Spectra", "Arm",
    "Torque and acceleration", "Sweep by sweep", "Convergence", "Clocks", "Sample times", "Channels",
    "Health", "Events", "Provenance",
]  # fmt: skip


class Page(HTMLParser):
    """What a page refers to, its ids, its headings, its figures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.references: list[str] = []
        self.ids: list[str] = []
        self.headings: list[str] = []
        self.figures = 0
        self._in_heading = False
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name in ("src", "href", "xlink:href", "data", "srcset", "action"):
                self.references.append(value or "")
            if name == "id":
                self.ids.append(value or "")
        self.figures += tag == "figure"
        self._in_heading = tag == "h2"

    def handle_data(self, data: str) -> None:
        if self._in_heading:
            self.headings.append(data)
            self._in_heading = False


@pytest.fixture(scope="module")
def page(short_mission: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a log whose name would be markup."""
    vehicle = config.load(config.packaged("rocksat"))
    path = tmp_path_factory.mktemp("report") / "rocksat.html"
    log = path.with_name("<b>a&b.mcap")
    log.symlink_to(short_mission.path)
    truth.write(log, with_quantities(vehicle, short_mission.flown.truth))
    assert report(log, path) == ()
    return path


def test_it_needs_nothing_but_itself(page: Path) -> None:
    text = page.read_text()
    found = Page(text)
    assert found.headings == SECTIONS
    assert found.figures >= 12
    assert len(found.references) >= 5
    assert all(reference.startswith("#") for reference in found.references)
    assert {reference[1:] for reference in found.references} <= set(found.ids)
    assert len(set(found.ids)) == len(found.ids)
    assert not re.search(r"@import|url\((?!#)", text)
    assert text.count("</script>") == text.count("<script") == 5


def test_it_says_what_was_said_in_flight_and_what_was_true(page: Path, short_mission: Result) -> None:
    """The answers are those of the terminal's table: all of them, in its order, with its errors."""
    text = page.read_text()
    told = [row for section in ("masses", "centres", "inertias", "parameters") for row in short_mission.table[section]]
    assert {row["quantity"] for row in told} >= {"m_tip_mass", "m_arm+m_tip_mass", "ZZ_joint_1_R_held"}
    rows = re.findall(r"<tr>(.*?)</tr>", text[text.index("Answers</h2>") :].split("</tbody>")[0])
    shown = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows[-len(told) :]]
    assert [row[0] for row in shown] == [row["label"] for row in told]
    assert [row[5] for row in shown] == [f"{row['our_error_percent']:+.2f}" for row in told]
    assert [row[6] for row in shown] == ["yes" if row["covered"] else "no" for row in told]
    assert f"{sum(row['covered'] for row in told)} of {len(told)} intervals hold the truth." in text
    for mass in short_mission.table["masses"]:
        assert f"{1e3 * mass['value']:.1f}" in text
    assert "5 of 5 quantities are determined by the data." in text
    assert "No record is missing" in text
    used = sum(int(np.count_nonzero(rows["gate"] == 0)) for _, rows in short_mission.log.batches(["row"]))
    assert f"{used:,} of {len(short_mission.log.read('row')):,} rows went into the estimate." in text


def test_what_a_log_says_of_itself_cannot_become_markup(page: Path) -> None:
    text = page.read_text()
    assert "<b>" not in text
    assert "&lt;b&gt;a&amp;b.mcap" in text


def test_a_sweep_alone_is_the_prior_and_its_rows(rng: np.random.Generator) -> None:
    """Information subtracted and put back: the difference of two logged states against the rows between them."""
    vehicle = config.load(config.packaged("rocksat"))
    (fresh, _), (flown, _), (again, _) = (build_identifier(vehicle) for _ in range(3))
    p, k = flown.rls.parameters, flown.rls.considered
    scale = np.sqrt(np.diag(np.linalg.inv(flown.rls.prior_equations()[0])))
    size = p + k + 1
    dtype = np.dtype([("vehicle_ns", "<i8"), ("triangle", "<f8", (size * (size + 1) // 2,))])

    def state(at_ns: int) -> np.void:
        row = np.zeros(1, dtype)[0]
        row["vehicle_ns"], row["triangle"] = at_ns, flown.rls.state().triangle[np.triu_indices(size)]
        return row

    def rows() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        Y = rng.normal(size=(200, p)) / scale
        return Y, rng.normal(size=200), np.full(200, 0.01), rng.normal(size=(200, k))

    flown.rls.update(*rows())
    before = state(0)
    states = []
    for block in range(8):
        part = rows()
        flown.rls.update(*part)
        again.rls.update(*part)
        states.append(state(block + 1))
    phase = Phase(0, 8, 3, "sweep 1", True)
    found = {one.name: one for one in alone(SweepData(phase, 8, True, None, {}, before, states), fresh)}
    expected = again.rls.solve().mean
    assert set(found) == {quantity.name for quantity in fresh.quantities} > set()
    for quantity in fresh.quantities:
        spread = float(np.sqrt(quantity.weights**2 @ scale**2))
        assert found[quantity.name].value[-1] == pytest.approx(quantity.weights @ expected, abs=1e-7 * spread)


class TestZoom:
    """Figures for Bokeh, made of the static ones."""

    def test_every_line_band_and_text_of_a_drawing_is_in_it(self) -> None:
        with theme.figures():
            figure, [axes] = theme.subplots()
            axes.plot([0.0, 1.0], [2.0, 3.0], label="<b>$$x$$")
            axes.fill_between([0.0, 1.0], [1.0, 1.0], [2.0, 2.0])
            axes.axvspan(0.2, 0.4)
            axes.axhline(0.5)
            axes.set_title("a $$\\frac{1}{2}$$ <script>")
            axes.set_ylabel("<img src=x>")
            axes.legend()
            other = axes.twinx()
            other.plot([0.0, 1.0], [20.0, 30.0], "x")
            [made] = json.loads(gzip.decompress(base64.b64decode(zoom.data([figure]))))
        names = re.findall(r'"name":"(\w+)","id"', json.dumps(made, separators=(",", ":")))
        count = {name: names.count(name) for name in ("Line", "Patches", "BoxAnnotation", "Span", "Scatter", "Legend")}
        assert (count["Line"], count["Scatter"], count["Patches"]) == (1, 1, 1)  # no copies for what is selected
        assert (count["BoxAnnotation"] >= 1, count["Span"], count["Legend"]) == (True, 1, 1)
        assert names.count("PlainText") == 4  # title, two labels of axes, second axis: none is mathematics

    def test_the_script_is_carried_once_and_unpacks(self, page: Path) -> None:
        text = page.read_text()
        [packed] = re.findall(r'id="bokeh">([^<]*)<', text)
        assert b"Bokeh" in gzip.decompress(base64.b64decode(packed))
        assert page.stat().st_size < 4_000_000

    def test_without_bokeh_there_are_the_drawings_only(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with theme.figures():
            draw, (figure, _) = Gallery(), theme.subplots()
            assert "<svg" in draw(figure, "a caption")
            assert set(draw.packed()) == {"bokeh", "figures", "roles"}
            monkeypatch.setattr("onboard.ground.drawing.gallery.zooms", lambda: False)
            assert draw.packed() == {}


@pytest.mark.skipif(BROWSER is None, reason="no browser to look with: apt install chromium")
class TestInABrowser:
    """Headless Chromium: light, dark, on paper."""

    def shot(self, page: Path, picture: Path, *options: str) -> Image.Image:
        assert BROWSER is not None
        command = [
            BROWSER,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--window-size=1200,5000",
        ]
        profile = f"--user-data-dir={picture.parent / 'profile'}"
        subprocess.run(
            [*command, profile, *options, f"--screenshot={picture}", page.as_uri()],
            check=True, capture_output=True, timeout=100,
        )  # fmt: skip
        return Image.open(picture).convert("L")

    def test_light_and_dark(self, page: Path, tmp_path: Path) -> None:
        light = np.asarray(self.shot(page, tmp_path / "light.png"))
        dark = np.asarray(self.shot(page, tmp_path / "dark.png", "--blink-settings=preferredColorScheme=0"))
        assert np.median(light) > 240
        assert np.median(dark) < 40
        for picture, paper in ((light, 255), (dark, np.median(dark))):
            inked = np.abs(picture.astype(int) - paper) > 40
            bands = inked.reshape(50, -1).mean(axis=1)
            assert (bands > 0.005).sum() > 45  # something to see all the way down
            assert not inked[:, :20].any()  # and nothing beyond the margin
            assert not inked[:, -20:].any()

    def test_on_a_telephone_nothing_lies_beside_the_screen(self, page: Path, tmp_path: Path) -> None:
        """390 px wide: the answers are a list with all their columns; no table cell but in what scrolls is cut off."""
        assert BROWSER is not None
        look = """<script>onload = () => {
            const inside = document.querySelector("iframe").contentDocument, width = 390;
            const right = (name) => Math.max(...[...inside.querySelectorAll(name)].map(
                (one) => one.getBoundingClientRect().right));
            document.body.textContent = JSON.stringify({
                page: inside.documentElement.scrollWidth, long: right(".stacks td"), figures: right("figure"),
                named: inside.querySelectorAll('.stacks td.long[data-of="level"]').length});
        };</script>"""
        frame = tmp_path / "frame.html"
        frame.write_text(f'<iframe src="{page.as_uri()}" style="border:0;width:390px;height:4000px"></iframe>{look}')
        command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files"]
        ran = subprocess.run(
            [*command, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", frame.as_uri()],
            check=True, capture_output=True, text=True, timeout=100,
        )  # fmt: skip
        found = json.loads(re.findall(r"\{.*\}", ran.stdout)[-1])
        assert found["named"] == 5
        assert 300 < found["page"] <= 390
        assert 300 < found["long"] <= 390
        assert 300 < found["figures"] <= 390

    def test_on_paper(self, page: Path, tmp_path: Path) -> None:
        assert BROWSER is not None
        pdf = tmp_path / "page.pdf"
        command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
        subprocess.run(
            [*command, "--no-pdf-header-footer", f"--print-to-pdf={pdf}", page.as_uri()],
            check=True, capture_output=True, timeout=100,
        )  # fmt: skip
        pages = len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes()))
        assert 4 <= pages <= 12


def test_a_log_of_one_channel_and_no_vehicle_makes_a_page(tmp_path: Path) -> None:
    rows = np.zeros(50, records.IMU)
    rows["sequence"] = range(50)
    rows["host_ns"] = np.arange(50) * 1_000_000
    make_log(tmp_path / "bare.mcap", {"imu_0": rows})
    report(tmp_path / "bare.mcap", tmp_path / "bare.html")
    text = (tmp_path / "bare.html").read_text()
    assert "carries no vehicle" in text
    assert "imu_0" in text


def test_a_log_without_a_vehicle_file_is_reported_with_the_one_that_is_given(tmp_path: Path) -> None:
    rows = np.zeros(100, records.SCALAR)
    rows["sequence"] = rows["tick"] = np.arange(100)
    rows["host_ns"], rows["scale"], rows["unit"] = 1_000_000_000 + np.arange(100) * 5_000_000, 1e-5, b"rad"
    make_log(tmp_path / "imported.mcap", {"joint_1": rows})
    told = ["report", str(tmp_path / "imported.mcap"), "-o", str(tmp_path / "page.html")]
    assert cli.main(told) == cli.OK
    page = (tmp_path / "page.html").read_text()
    assert "imported.mcap carries no vehicle file; give the vehicle that flew with --vehicle" in page
    assert page.count(tempfile.gettempdir()) == page.count(str(tmp_path))  # no other directory is named
    assert cli.main([*told, "--vehicle", "rocksat"]) == cli.OK
    assert "carries no vehicle file" not in (tmp_path / "page.html").read_text()
