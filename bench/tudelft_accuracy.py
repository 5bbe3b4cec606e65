"""Real throws (tudelft_tumbling): how far off the flight's estimator is, and whether its intervals cover.

Run ``python bench/tudelft_accuracy.py DIR`` with the directory of the recordings. Rows lie at whole multiples of the
row period of the recorder's clock, wherever that happened to stand; ``--offsets`` moves it, to show how much of a
number is luck.
"""

import argparse
import os
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench import given
from onboard import config
from onboard.estimation.arrays import FloatArray
from onboard.ground.identify.identify import Identification, identify
from onboard.ground.log.bring_in import importer
from onboard.identification.rows.free_body import PrincipalMoments

ROW_PERIOD_US = 5000
MAPPING = Path(importer.__file__).parent / "mappings" / "tudelft.toml"


def identify_at(source: Path, offset_us: float) -> Identification:
    """All loads, with the recorder's clock moved by ``offset_us``."""
    text = MAPPING.read_text(encoding="utf-8").replace('unit = "us"', f'unit = "us"\noffset = {offset_us}', 1)
    with tempfile.TemporaryDirectory() as directory:
        mapping = Path(directory) / "moved.toml"
        mapping.write_text(text, encoding="utf-8")
        logs = importer.import_recordings(mapping, source, Path(directory))
        vehicle = config.load(config.packaged("tudelft"))
        return identify(vehicle, [log.path for log in logs])


def _half(moments: PrincipalMoments) -> FloatArray:
    return np.asarray((moments.high - moments.low) / (2.0 * moments.moments), np.float64)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=given.directory_with("*.npz"), help="directory of the recordings (*.npz)")
    parser.add_argument("--offsets", type=int, default=4, help="positions of the recorder's clock (default 4)")
    arguments = parser.parse_args()
    print(f"{'':39}{'error, norm':>15}{'half width, median':>22}{'error / sigma':>15}")
    heads = f"{'covered':>9}{'mean':>8}{'worst':>7}{'alone':>11}{'together':>11}{'rms':>15}"
    print(f"{'offset':>9}  {'load':12}{'throws':>7}{heads}")
    for index in range(arguments.offsets):
        offset_us = index * ROW_PERIOD_US / arguments.offsets
        found = identify_at(arguments.source, offset_us)
        for one in found.summaries:
            mine = [log.throw.principal for log in found.logs if log.throw and log.throw.load.name == one.load.name]
            told = [moments for moments in mine if moments is not None]
            truth = np.sort(np.array(one.load.truth_kg_m2))
            rms = np.sqrt(np.mean([((moments.moments - truth) / moments.sigma) ** 2 for moments in told]))
            pooled = one.together.principal if one.together else None
            together = f"{np.median(_half(pooled)):.1%}" if pooled else ""
            print(
                f"{offset_us * 1e-3:6.2f} ms  {one.load.name:12}{one.answered:7d}{one.covered_percent:8.0f}%"
                f"{one.mean_percent:7.2f}%{one.worst_percent:6.2f}%{np.median([_half(each) for each in told]):11.1%}"
                f"{together:>11}{rms:15.2f}"
            )


if __name__ == "__main__":
    main()
