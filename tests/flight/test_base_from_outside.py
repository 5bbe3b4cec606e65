"""A kind of base from another package, added by its entry point: its rows of a whole flight are made and identified.

``RAIL`` moves along and about x alone, and its motion is measured. Rows of the joints use the measured motion whatever
the base, so the answers are those of a prescribed base. Nothing of heft names the kind.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import cli, config
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.regressor.base_parameters import SampledMotion
from onboard.regressor.rows import base_force_rows, base_moment_rows
from tests.flight import elsewhere
from tests.flight.elsewhere import heft
from tests.flight.missions import Result

RAIL = BaseKind("rail", "slides along x and tilts about it, measured", (0, 3))
PACKAGE = f"from onboard.dynamics.model.bases import BaseKind\nRAIL = {RAIL!r}\nSQUARE = 'no kind'\n"
POINTS = "[heft.bases]\nrail = rails:RAIL\nsquare = rails:SQUARE\nfree = rails:RAIL\n"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("rails")
    (elsewhere.installed(directory, "rails", POINTS) / "rails.py").write_text(PACKAGE)
    packaged = config.packaged("rocksat")
    shutil.copy(packaged.parent / "rocksat.urdf", directory)
    for base in ("prescribed", "rail", "square"):
        text = packaged.read_text().replace('base = "prescribed"', f'base = "{base}"', 1)
        (directory / f"{base}.toml").write_text(text)
    return directory


@pytest.mark.campaign  # its rows: below; a flight with a package from outside: test_toy_device
def test_a_flight_is_identified_with_it(installed: Path, short_mission: Result) -> None:
    answers: dict[str, Any] = {}
    for base in ("prescribed", "rail"):
        out = installed / f"{base}.json"
        told = ["identify", "--vehicle", str(installed / f"{base}.toml"), str(short_mission.path), "--json", str(out)]
        if base == "rail":
            assert heft(installed, *told).returncode in (cli.OK, cli.FAILED)
        else:
            assert cli.main(told) in (cli.OK, cli.FAILED)
        (log,) = json.loads(out.read_text())["logs"]
        answers[base] = {one["name"]: one["value"] for one in log["quantities"]}
    assert len(answers["rail"]) >= 3
    assert answers["rail"] == pytest.approx(answers["prescribed"], rel=1e-9, nan_ok=True)


def test_its_rows_are_of_what_it_moves_by() -> None:
    text = (config.packaged("rocksat").parent / "rocksat.urdf").read_text()
    model = VehicleModel(text, VehicleSpec(RAIL, config.load(config.packaged("rocksat")).file.vehicle.base_link))
    rows = [*base_force_rows(model), *base_moment_rows(model)]
    assert [row.name for row in rows] == ["base_force_x", "base_moment_x"]
    motion = SampledMotion.of(RAIL)
    assert np.array_equal(motion.specific_force_m_s2, (1.0, 0.0, 0.0))
    assert np.array_equal(motion.rate_rad_s, (1.0, 0.0, 0.0))


def test_what_cannot_be_used_grounds_the_vehicles_that_use_it(installed: Path) -> None:
    said = heft(installed, "preflight", "square.toml")
    assert said.returncode == 2
    assert "base 'square': rails:SQUARE of rails is no BaseKind of name[\"square\"]: mend it" in said.stderr
    known = config.load(config.packaged("rocksat")).file.vehicle.base_kind
    assert known is BaseKind.PRESCRIBED


def test_without_its_package_the_vehicle_is_refused(installed: Path) -> None:
    with pytest.raises(config.ConfigError, match=r'rail\.toml:7: .*"rail" is none of free, prescribed'):
        config.load(installed / "rail.toml")
