"""What is told of a payload while an instrument is left out."""

from types import SimpleNamespace

import numpy as np
import pytest

from onboard.identification.exiddm.further import CellPrior, FurtherCell
from onboard.identification.exiddm.fusion import Fusion
from onboard.identification.exiddm.imu_prediction import PAYLOAD
from onboard.identification.exiddm.online import ExiddmIdentifier

SIGMA, SCALE_AT = 0.0025, 13
CELL = FurtherCell("cell", "wrist", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 5, CellPrior(0.0, 0.0, SIGMA, 0.0))


@pytest.mark.parametrize(
    ("left_out", "kind", "doubted"), [(1, "left_out", True), (1, "absent", False), (2, "left_out", False)]
)
def test_with_an_imu_left_out_the_answer_is_that_of_a_wide_prior_of_the_cells_scale(
    left_out: int, kind: str, doubted: bool, rng: np.random.Generator
) -> None:
    """Linear rows with a prior on the scale alone: the same rows with a prior 20 times as wide give the answer."""
    fusion = Fusion(("imu", "imu_2", "cell"), (slice(0, 6), slice(6, 12), slice(12, 13)))
    fusion.leave_out(left_out, kind=kind)
    A, b = rng.standard_normal((40, SCALE_AT + 1)), rng.standard_normal(40)
    A[:, SCALE_AT] *= 100.0

    def solved(sigma: float) -> tuple[np.ndarray, np.ndarray]:
        information = A.T @ A
        information[SCALE_AT, SCALE_AT] += sigma**-2
        return np.linalg.solve(information, A.T @ b), np.linalg.inv(information)

    state, covariance = solved(SIGMA)
    predictor = SimpleNamespace(
        vehicle=SimpleNamespace(spec=SimpleNamespace(payload_link="payload")),
        further=(SimpleNamespace(name="imu_2", width=6), CELL),
        of_further=[np.zeros(0, np.intp), np.array([SCALE_AT])],
        imu_frames=("imu", "imu_2"),
        sigma=np.full(SCALE_AT + 1, SIGMA),
    )
    quiet = SimpleNamespace(strongest=None, by_instrument=dict)
    online = ExiddmIdentifier(
        SimpleNamespace(predictor=predictor, fusion=fusion, covariance=covariance, lines=quiet, misfit=quiet)
    )
    wanted, wide = solved(20.0 * SIGMA if doubted else SIGMA)
    mean, told = online._payload(state)
    np.testing.assert_allclose(mean, wanted[PAYLOAD], rtol=1e-9)
    np.testing.assert_allclose(told, wide[PAYLOAD, PAYLOAD], rtol=1e-6, atol=1e-12)
