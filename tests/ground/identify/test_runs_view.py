"""The table of runs of parabolic flights keeps every number where the terminal has 80 columns."""

import io

from rich.console import Console

from onboard.ground.identify import runs_view

RUN = {
    "parabola": 32,
    "flown": "medium pitch then yaw",
    "release_s": 1101.51,
    "catch_s": 1117.35,
    "bumps_s": [1110.0],
    "motions_s": [[1103.0, 1109.0], [1111.0, 1115.0]],
    "state": "identified",
    "reason": "",
    "quantities": [{"unit": "kg", "value": 1.234, "low": 1.0, "high": 1.5}],
}


def test_no_number_is_cut_in_80_columns() -> None:
    out = io.StringIO()
    Console(file=out, width=80).print(*runs_view.render([RUN]))
    said = out.getvalue()
    assert max(len(line) for line in said.splitlines()) <= 80
    assert "…" not in said
    for number in ("33", "1101.51", "1117.35", "1.234 ± 0.250", "identified"):
        assert number in said
