"""What ``heft identify`` says of a link beside the answers."""

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from onboard import config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.ground.identify import identify_view
from onboard.ground.identify.identify import Identification
from onboard.ground.identify.kinds.identified import Identified
from onboard.identification.rows.standard import link_estimate
from onboard.identification.standing import Level
from onboard.identification.verdict import Verdict

MEAN = standard_of(RigidBody(1.2, np.array([0.1, 0.0, 0.02]), np.diag([0.01, 0.02, 0.02])))


@pytest.mark.parametrize(("sigma_kg", "apart"), [(0.01, True), (0.9, False)])
def test_the_mass_of_a_link_has_its_interval_and_one_that_is_not_determined_says_so(sigma_kg: float, apart: bool):
    link = link_estimate("tool", MEAN, np.diag([sigma_kg, *[1e-3] * 3, *[1e-4] * 6]) ** 2)
    log = Identified(Path("run.mcap"), "rows", (), 100, {}, (), Verdict(Level.GOOD, (), ()), links=(link,))
    out = io.StringIO()
    Console(file=out, width=80).print(
        identify_view.render(Identification(config.load(config.packaged("workshop")), (log,), None))
    )
    said = " ".join(out.getvalue().split())
    assert ("1.200 ± 0.020 kg, centre of mass 100.0 ± 2.3" if apart else "1.2 ± 1.8 kg, centre of mass 100") in said
    assert ("do not tell its mass apart" in said) != apart
