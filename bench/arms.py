"""Recorded arms on a fixed base: base parameters of the Staubli TX40, torque prediction on the KUKA LWR 4.

Each recording goes through ``heft import`` and ``heft identify`` as anybody's does; here the answers are laid beside
the published table, and beside the torques of the run that was not used. Run ``python bench/arms.py`` with the data
sets in $HEFT_DATASETS or ../shared/datasets.
"""

import argparse
import csv
import os
import re
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench import given
from onboard import config
from onboard.ground.identify.identify import identify, predict
from onboard.ground.log.bring_in.importer import import_recordings

Floats = NDArray[np.float64]

SIGMA_PERCENT = 5.0  # of the published parameters that count as well identified
SHARED = ("Ia", "Fv")  # the table's columns of the last two joints hold what motor 6 adds to their diagonal


def tx40(directory: Path, logs: Path) -> tuple[Floats, Floats]:
    """Published over found, less one, of the well identified parameters: by the table's OLS column and by its WLS one.

    The table was made without the last joint's acceleration (its code's loop leaves it out), so of theory's 61
    parameters ``Ia_joint_6`` is not in it.
    """
    vehicle = config.load(config.packaged("staubli_tx40"), directory / "tx40_mdh_modified.urdf")
    (log,) = import_recordings("staubli_tx40", directory / "pos_read_data.csv", logs)
    (found,) = identify(vehicle, [log.path]).logs
    values = {answer.name.removesuffix("_R"): answer.value for answer in found.answers}
    with (directory / "TX40_bp_5.csv").open(encoding="utf-8") as file:
        table = [(_ours(row[0], values), [float(cell) for cell in row[1:]]) for row in csv.reader(file)]
    ours, published = np.array([value for value, _ in table]), np.array([numbers for _, numbers in table])
    ols, wls = (
        np.abs(ours / published[:, column] - 1.0)[published[:, column + 1] < SIGMA_PERCENT] for column in (0, 2)
    )
    return ols, wls


def _ours(published: str, values: dict[str, float]) -> float:
    """Our value of ``mx2 + 0.225*m3 ...``, which is ``MX_link_2``."""
    head = published.split(maxsplit=1)[0]
    coupled = {"Iam6": "Ia_motor_6", "fvm6": "Fv_motor_6", "fsm6": "Fc_motor_6"}
    if head in coupled:
        return values[coupled[head]]
    found = re.fullmatch(r"(Ixx|Ixy|Ixz|Iyy|Iyz|Izz|mx|my|mz|m|Ia|fv|fs|off)(\d)", head)
    assert found is not None, published
    kind, number = found.groups()
    of_joint = {"Ia": "Ia", "fv": "Fv", "fs": "Fc"}
    if kind == "off":
        return values[f"bias_torque_{number}"]
    if kind not in of_joint:
        return values[f"{kind.removeprefix('I').upper()}_link_{number}"]
    of_motor = values[f"{of_joint[kind]}_motor_6"] if of_joint[kind] in SHARED and number in "56" else 0.0
    return values[f"{of_joint[kind]}_joint_{number}"] + of_motor


def lwr4(directory: Path, logs: Path) -> tuple[float, float]:
    """Relative torque error of run 2 from run 1, and of run 1's second half from its first."""
    vehicle = config.load(config.packaged("kuka_lwr4"), directory / "kuka_lwr4.urdf")
    one, two = (
        import_recordings("kuka_lwr4", directory / f"HW_measurements_{number}.npz", logs)[0].path for number in (1, 2)
    )
    found = identify(vehicle, [one])
    assert found.logs[0].held_out is not None
    return predict(vehicle, found.logs[0], two).relative_error, found.logs[0].held_out.later.relative_error


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    recorded = given.directory_with("staubli_tx40/*", "kuka_lwr4/*")
    parser.add_argument("--datasets", type=recorded, default=given.DATASETS)
    datasets = parser.parse_args().datasets
    with tempfile.TemporaryDirectory() as directory:
        logs = Path(directory)
        ols, wls = (100.0 * errors for errors in tx40(datasets / "staubli_tx40", logs))
        print("Staubli TX40: the published table's well identified parameters, median and largest difference, per cent")
        print(f"  OLS column {np.median(ols):5.2f} (bar 0.60) {ols.max():5.1f}   of {ols.size}")
        print(f"  WLS column {np.median(wls):5.2f} (bar 0.79) {wls.max():5.1f}   of {wls.size}")
        other, half = (100.0 * error for error in lwr4(datasets / "kuka_lwr4", logs))
        print("KUKA LWR 4: relative torque error, per cent")
        print(f"  run 2 from run 1                    {other:6.2f} (bar 1.9)")
        print(f"  run 1's second half from its first  {half:6.2f}")


if __name__ == "__main__":
    main()
