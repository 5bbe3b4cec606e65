"""The table of a rehearsal, as a terminal shows it."""

import io

from rich.console import Console

from onboard.ground.identify.mission import answered, mission_table


def row(label, truth, value, half):
    low, high = value - half, value + half
    percent, sigmas = answered.error(value, low, high, half / 2, truth)
    told = {"value": value, "low": low, "high": high, "our_error_percent": percent, "our_error_sigmas": sigmas}
    return {"label": label, "truth": truth, "supported": True, "standing": "good", "leans": "", **told} | {
        "shown_in": "g m²",
        "factor": 1e3,
        "digits": 3,
    }


def test_an_error_is_a_share_of_the_truth_where_there_is_one():
    rows = [row("I_xx", 1.35e-4, 1.31e-4, 1.9e-5), row("I_xy", -1.7e-11, -1.14e-6, 2.2e-6)]
    empty = dict.fromkeys(("masses", "centres", "parameters", "motions", "runs", "accounts", "events"), ())
    screen = io.StringIO()
    table = {"title": "it", "seed": 7, "capture": None, **empty, "inertias": rows}
    Console(file=screen, width=80).print(mission_table.render(table))
    lines = {line.split(",")[0].strip(): line.rstrip() for line in screen.getvalue().splitlines() if " .. " in line}
    assert lines["I_xx"].endswith("-2.96")
    assert lines["I_xy"].endswith("-1.0 σ")
