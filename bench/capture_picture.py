"""Draws docs/capture.svg: what DYMAFLEX says on board of the payload that it has captured, and the truth.

``python -m bench.capture_picture docs/capture.svg`` flies ``heft hil dymaflex`` and reads its log.
"""

import json
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from onboard.cli import main
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

_SHOWN = (("m_payload", "mass, kg", 1.0, 0.05), ("c_x_payload", "centre of mass x, mm", 1e3, 0.1))
"""Quantity, its title, the unit's factor, and the share of the truth that is shown on either side."""


def draw(log: Path, output: Path) -> None:
    """One panel a quantity: estimate, 95 % interval and truth over mission time.

    Args:
        log: of the flight.
        output: the picture; its suffix selects the format.
    """
    truth = json.loads(log.with_name(f"{log.name}.truth.json").read_text(encoding="utf-8"))
    rows = np.concatenate([batch for _, batch in LogReader(log).batches(["quantity"])])
    names = np.array([printable(raw) for raw in rows["name"]])
    mpl.rcParams.update({"font.size": 9, "svg.hashsalt": "heft", "axes.spines.top": False, "axes.spines.right": False})
    figure = Figure(figsize=(7.2, 2.6), layout="constrained")
    for axes, (name, label, factor, share) in zip(figure.subplots(1, 2), _SHOWN, strict=True):
        own = rows[(names == name) & (rows["supported"] > 0)]
        at_s = 1e-9 * (own["vehicle_ns"].astype(np.float64) - float(truth["start_ns"]))
        true = factor * float(truth["quantities"][name])
        axes.fill_between(at_s, factor * own["low"], factor * own["high"], color="#2a78c8", alpha=0.25, lw=0)
        axes.plot(at_s, factor * own["value"], color="#2a78c8", lw=1.2, label="estimate, 95 % interval")
        axes.axhline(true, color="#c8402a", lw=0.9, ls="--", label="truth")
        axes.axvline(float(truth["capture_s"]), color="0.5", lw=0.9, ls=":", label="capture")
        axes.set(ylim=(true * (1.0 - share), true * (1.0 + share)), xlim=(0.0, None), xlabel="time, s", title=label)
    axes.legend(loc="lower right", frameon=False, fontsize=8)
    figure.savefig(output, metadata={"Date": None} if output.suffix == ".svg" else None, facecolor="white", dpi=150)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        flown = Path(directory) / "flight.mcap"
        if main(["hil", "dymaflex", "--log", str(flown)]):
            raise SystemExit(1)
        draw(flown, Path(sys.argv[1]))
