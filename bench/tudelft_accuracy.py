"""Real throws (tudelft_tumbling): how far off the flight's estimator is, and whether its intervals cover.

Run ``python bench/tudelft_accuracy.py DIR`` with the directory of the recordings. Rows lie at whole multiples of the
row period of the recorder's clock, wherever that happened to stand; ``--offsets`` moves it, to show how much of a
number is luck. ``--smoothing`` and ``--width-ms`` take another kernel than the vehicle file's: the Kalman filter
("filter", causal) and its smoother ("smoother", offline) need twice the spline's width for its band.
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from onboard import config
from onboard.offline.bring_in import importer
from onboard.offline.estimate_again.identify import identify
from onboard.offline.estimate_again.throws import LoadSummary

ROW_PERIOD_US = 5000
MAPPING = Path(importer.__file__).parent / "mappings" / "tudelft.toml"


def identify_at(source: Path, offset_us: float, smoothing: str, width_ms: float) -> list[LoadSummary]:
    """The summaries of all loads, with the recorder's clock moved by ``offset_us``."""
    text = MAPPING.read_text(encoding="utf-8").replace('unit = "us"', f'unit = "us"\noffset = {offset_us}', 1)
    with tempfile.TemporaryDirectory() as directory:
        mapping = Path(directory) / "moved.toml"
        mapping.write_text(text, encoding="utf-8")
        logs = importer.import_recordings(mapping, source, Path(directory))
        vehicle = config.load(_smoothed_by(smoothing, width_ms, Path(directory)))
        return identify(vehicle, [log.path for log in logs]).summaries


def _smoothed_by(smoothing: str, width_ms: float, directory: Path) -> Path:
    packaged = config.packaged("tudelft")
    text = packaged.read_text(encoding="utf-8")
    keys = f'smoothing = "{smoothing}"\nsmoothing_ms = {width_ms}'
    changed = text.replace("smoothing_ms = 100", keys, 1).replace("lag_ms = 100", f"lag_ms = {width_ms}", 1)
    if changed.count(keys) != 1:
        raise ValueError(f"{packaged}: no smoothing_ms = 100 to replace")
    (directory / "vehicle.toml").write_text(changed, encoding="utf-8")
    (directory / "tudelft.urdf").write_bytes(packaged.with_name("tudelft.urdf").read_bytes())
    return directory / "vehicle.toml"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="directory of the recordings (*.npz)")
    parser.add_argument("--offsets", type=int, default=4, help="positions of the recorder's clock (default 4)")
    parser.add_argument("--smoothing", choices=("spline", "filter", "smoother"), default="spline")
    parser.add_argument("--width-ms", type=float, default=100.0, help="of the kernel (default 100)")
    arguments = parser.parse_args()
    print(f"{'offset':>9}  {'load':12}{'throws':>7}{'mean':>8}{'bar':>7}{'worst':>8}{'bar':>7}{'covered':>9}")
    for index in range(arguments.offsets):
        offset_us = index * ROW_PERIOD_US / arguments.offsets
        for one in identify_at(arguments.source, offset_us, arguments.smoothing, arguments.width_ms):
            bars = [f"{bar:.1f}%" for bar in one.load.bars_percent or ()] or ["", ""]
            print(
                f"{offset_us * 1e-3:6.2f} ms  {one.load.name:12}{one.answered:7d}{one.mean_percent:7.2f}%{bars[0]:>7}"
                f"{one.worst_percent:7.2f}%{bars[1]:>7}{one.covered_percent:8.0f}%"
            )


if __name__ == "__main__":
    main()
