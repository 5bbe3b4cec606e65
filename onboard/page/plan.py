"""The plan's expected intervals, which the page shows beside those of the answers."""

import json
import math
from pathlib import Path
from statistics import NormalDist
from typing import Any

_HALF = NormalDist().inv_cdf(0.975)


def read(path: Path | None) -> dict[str, dict[str, Any]]:
    """``half`` (of the 95 % interval at the plan's end) and ``unit`` of each quantity of a ``plan.json``.

    Those that the plan cannot tell are left out; without a path there are none.

    Raises:
        ValueError: not a plan of a motion; the message gives the remedy.
    """
    if path is None:
        return {}
    try:
        expected = json.loads(path.read_bytes())["expected"]
        found = {str(one["name"]): (_HALF * float(one["sigma"]), str(one["unit"])) for one in expected}
    except OSError as error:
        raise ValueError(f"--page-plan {path}: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"--page-plan {path}: give the plan.json that heft plan wrote for one motion") from error
    return {name: {"half": half, "unit": unit} for name, (half, unit) in found.items() if 0.0 < half < math.inf}
