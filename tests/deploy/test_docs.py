"""The documentation: its commands exist with their options, the tour runs, the site builds without warnings."""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bench.architecture_picture import floors, imports, modules
from hil_sim.devices import vehicle_file
from hil_sim.devices.vehicle_file import scenario_of
from onboard.cli import main, parser
from onboard.ground.campaign import plan_file
from onboard.ground.campaign.design import items
from onboard.ground.drawing import gallery
from tests.flight.missions import SHORTER

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [
        *(ROOT / page for page in ("README.md", "CONTRIBUTING.md", "bench/README.md", "deploy/README.md")),
        *(ROOT / "docs").rglob("*.md"),
    ]
)
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_LINE = re.compile(r"^(?: {4}|\$ )?((?:\.venv/bin/)?heft [a-z].*)$", re.MULTILINE)
_SPAN = re.compile(r"`((?:\.venv/bin/)?heft [^`]+)`")
_SCRIPT = re.compile(r"(?:python|sh|bash) ((?:bench|deploy|tests)/[\w/]+\.\w+)|python -m ((?:bench|tests)(?:\.\w+)+)")


def _nested(of: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Its subcommands."""
    return dict(next((it.choices for it in of._actions if isinstance(it, argparse._SubParsersAction)), {}))


def _unknown(snippet: str, commands: dict[str, argparse.ArgumentParser]) -> str:
    """What of a command line, or of a usage with brackets and bars, heft does not have; empty if nothing."""
    words = re.sub(r"[\[\]|]|\.\.\.", " ", snippet).split()[1:]
    name = words[0].rstrip(",")
    if name not in commands:
        return "" if name in ("--version", "--help", "COMMAND") else name
    readers = [commands[name], *_nested(commands[name]).values()]
    known = {option for reader in readers for action in reader._actions for option in action.option_strings}
    asked = [word.split("=")[0].rstrip(",)") for word in words[1:] if re.match(r"--?[a-z]", word)]
    return next((option for option in asked if option not in known), "")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_command_shown_exists_with_its_options(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    commands = _nested(parser())
    found = _SPAN.findall(_FENCE.sub("", text))
    for block in _FENCE.findall(text):
        found += [line.split(" #")[0] for line in _LINE.findall(block.replace("\\\n", " "))]
    snippets = [" ".join(snippet.replace("\\|", "|").split()) for snippet in found]
    wrong = {snippet: unknown for snippet in snippets if (unknown := _unknown(snippet, commands))}
    assert not wrong
    for script, module in _SCRIPT.findall(text):
        path = ROOT / (script or module.replace(".", "/"))
        assert path.is_file() or path.is_dir() or path.with_suffix(".py").is_file(), path


def test_recipes_are_plans_or_scenarios_that_differ_from_the_vehicles_own(tmp_path: Path) -> None:
    blocks = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8"), re.DOTALL)
    usual = scenario_of("dymaflex", {})
    assert len(blocks) == 8
    for block in blocks:
        scenarios = [tomllib.loads(block)]
        if "campaign" in scenarios[0]:
            plan = tmp_path / "plan.toml"
            plan.write_text(block)
            flights = items(plan_file.read(plan))
            assert len({str(flight.scenario) for flight in flights}) > 1
            scenarios = [flight.scenario for flight in flights]
        for scenario in scenarios:
            assert scenario_of("dymaflex", scenario) != usual, block


def test_the_changelog_is_what_a_user_notices() -> None:
    releases = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1:]
    assert len(releases) >= 3
    assert {release.split()[0]: n for release in releases if (n := len(release.splitlines())) > 60} == {}


def test_the_picture_of_the_rooms_is_of_this_code() -> None:
    """Otherwise: ``python -m bench.architecture_picture docs/architecture.svg docs/sample.svg``."""
    shown = set(re.findall(r">([\w.]+)</text>", (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")))
    rooms = {room for room, _, _ in modules(ROOT)}
    assert len(rooms) > 15
    assert {room.removeprefix("onboard.") for room in rooms} == shown


def test_imports_of_rooms_are_found_in_whatever_way_they_are_written(tmp_path: Path) -> None:
    for name, text in (
        ("onboard/__init__.py", "import hil_sim"),
        ("onboard/ring.py", "import drivers.records\nimport numpy\n"),
        ("onboard/flight/hil.py", "def late():\n    from hil_sim import mission\nfrom ..config import vehicle\n"),
        ("onboard/config/vehicle.py", "from . import checks\n"),
        ("drivers/records.py", ""),
        ("hil_sim/mission.py", "import onboard.absent\n"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert imports(tmp_path) == {
        "drivers": set(),
        "onboard.ring": {"drivers"},
        "onboard.flight": {"hil_sim", "onboard.config"},
        "onboard.config": set(),
        "hil_sim": set(),
    }


def test_rooms_stand_above_what_they_import_and_circles_are_refused() -> None:
    assert floors({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"c": 0, "b": 1, "a": 2}
    with pytest.raises(ValueError, match=r"import each other: \['a', 'b'\]"):
        floors({"a": {"b"}, "b": {"a"}, "c": set()})


def test_a_command_that_does_not_exist_is_noticed() -> None:
    commands = _nested(parser())
    assert _unknown("heft ponder LOG", commands) == "ponder"
    assert _unknown("heft info LOG --clock PNG", commands) == "--clock"
    assert _unknown("heft fly vehicle.toml [--live] [--quiet|--json-lines]", commands) == ""


def test_the_tour_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Each command of its blocks in order, those of ``heft`` and Python in this process, on missions of 8 s, not 63 s.

    ``sh deploy/hil.sh`` is its command without the environment; of a log that is cut as large a part is kept.
    """
    monkeypatch.setattr(vehicle_file, "scenario_of", lambda name, *_: scenario_of(name, {"sequence": SHORTER}))
    monkeypatch.setattr(gallery, "zooms", lambda: False)  # figures that zoom: test_report
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert sum(kind == "python" for kind, _ in blocks) == 1
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("COLUMNS", "80")
    done = 0
    for kind, block in blocks:
        for line in [block] if kind == "python" else block.splitlines():
            words = shlex.split(line, comments=True) if kind == "sh" else []
            code = re.search(r"# exit code (\d)", line)
            if words[:2] == ["sh", "deploy/hil.sh"]:
                returned = main(["hil", "rocksat"])
            elif words[:1] == ["heft"]:
                returned = main(words[1:])
            elif kind == "python":
                exec(block, {})
                returned = 0
            else:
                part = re.sub(r"(?<=^head -c )\d+", lambda cut: str(int(cut[0]) * 8 // 63), line)
                returned = subprocess.run(["sh", "-c", part], check=False).returncode
            said = capfd.readouterr()
            assert returned == (int(code[1]) if code else 0), (line, said.out[-2000:], said.err[-2000:])
            assert "Traceback" not in said.err, line
            done += 1
    assert done >= 15


def test_the_site_builds_without_warnings(tmp_path: Path) -> None:
    """Not ``--quiet``: ``--strict`` counts the warnings that are logged, and there it would count none."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict"]
    command += ["--config-file", str(ROOT / "deploy" / "mkdocs.yml"), "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (0, ""), ran.stderr
    assert "WARNING" not in ran.stderr
    listed = re.findall(r": ([\w/]+\.md)$", (ROOT / "deploy" / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    pages = {page.relative_to(ROOT / "docs") for page in PAGES if page.is_relative_to(ROOT / "docs")}
    assert {page.as_posix() for page in pages} == set(listed)
    assert all((tmp_path / page.with_suffix(".html")).is_file() for page in pages)
    for page in pages:  # a list in a list's item that is not indented as its text is one paragraph
        shown = re.sub(
            r"<pre.*?</pre>", "", (tmp_path / page.with_suffix(".html")).read_text(encoding="utf-8"), flags=re.DOTALL
        )
        assert not re.search(r"<p>[^<]*(?:<(?!/p>)[^<]*)*\n *(?:- |\d+\. |\|)", shown), page
        assert not re.search(
            r"</ol>\s*<div class=\"(?:language|highlight)(?:(?!<ol|<h\d|<p>).)*<ol>", shown, re.DOTALL
        ), page
    numbers, keys = (
        (tmp_path / f"{page}.html").read_text(encoding="utf-8") for page in ("evidence/scoreboard", "vehicle")
    )
    assert ("<table data-stacked>" in numbers, "<table data-stacked>" in keys) == (False, True)
    assert '<td data-label="default">' in keys
    levels = (tmp_path / "honesty.html").read_text(encoding="utf-8")
    assert levels.count('href="glossary.html#leans-on"') == 1  # the first use, and no other
    assert '<a id="leans-on">' in (tmp_path / "glossary.html").read_text(encoding="utf-8")
    assert "<code>heft watch [LOG|--live] [--page]</code>" in (tmp_path / "commands.html").read_text(encoding="utf-8")
    theory = (tmp_path / "estimators.html").read_text(encoding="utf-8")
    assert "<math" in theory
    assert not re.search(r"\$[\\A-Za-z]", theory)  # no formula that was left as text
