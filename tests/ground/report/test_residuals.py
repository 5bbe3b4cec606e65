"""Whitened residuals: rows with known errors come back as series, white noise as uncorrelated."""

import numpy as np
import pytest

from onboard.ground.drawing import theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.identify.kinds.identified import KeptRows, autocorrelation, by_axis
from onboard.ground.report.identified import residual_section
from onboard.identification.rows.row_blocks import RowBlocks


def test_rows_come_back_whitened_by_instrument_with_gaps_kept(rng: np.random.Generator) -> None:
    blocks, mean = RowBlocks(2, 1.0, ("cell", "base")), np.array([3.0, -2.0])
    kept = KeptRows(blocks.instruments)
    blocks.listener = kept.keep
    ticks = np.delete(np.arange(100), 40)  # a tick is missing
    errors, series = rng.normal(size=(99, 3)), []
    for tick, error in zip(ticks, errors, strict=True):  # a row of the cell, two of the base
        Y, sigma = rng.normal(size=(3, 2)), np.array([0.1, 0.2, 0.3])
        held, instrument = np.ones(3, bool), np.array([0, 1, 1])
        blocks.add(np.full(3, 7.0 + 0.01 * tick), held, instrument, Y, Y @ mean + sigma * error, sigma, sigma, None)
        series.append(error)
    found = kept.residuals(mean, 0.01)
    assert list(found) == ["cell", "base 1", "base 2"]
    for name, expected in zip(found, np.array(series).T, strict=True):
        assert len(found[name]) == 100
        assert np.flatnonzero(np.isnan(found[name])).tolist() == [40]
        assert found[name][ticks] == pytest.approx(expected, abs=1e-9)


def test_ticks_of_a_fit_come_back_by_axis_with_gaps_kept(rng: np.random.Generator) -> None:
    ticks, left = np.array([0, 1, 2, 7, 8]), rng.normal(size=(5, 6))
    left[1] = np.nan
    found = by_axis(3.0 + 0.01 * ticks, left, 0.01)
    assert list(found) == ["gyro x", "gyro y", "gyro z", "accelerometer x", "accelerometer y", "accelerometer z"]
    for series, expected in zip(found.values(), left.T, strict=True):
        assert np.flatnonzero(np.isfinite(series)).tolist() == [0, 2, 7, 8]
        assert series[ticks].tolist() == pytest.approx(expected.tolist(), nan_ok=True)


def test_autocorrelation_of_a_known_process_over_holes(rng: np.random.Generator) -> None:
    noise, series = rng.normal(size=20_000), np.zeros(20_000)
    for k in range(1, len(series)):
        series[k] = 0.8 * series[k - 1] + noise[k]
    series[rng.random(len(series)) < 0.2] = np.nan
    assert autocorrelation(series, 4) == pytest.approx(0.8 ** np.arange(5), abs=0.04)
    assert np.abs(autocorrelation(noise, 4)[1:]).max() < 0.03
    assert np.isnan(autocorrelation(np.full(10, np.nan), 2)).all()


def test_the_section_says_and_draws_each_series(rng: np.random.Generator) -> None:
    with theme.figures():
        text = residual_section({"<b>cell": rng.normal(size=500)}, Gallery())
        assert residual_section({"cell": np.full(9, np.nan)}, Gallery()).startswith("<p>No residuals")
    assert ">&lt;b&gt;cell</td>" in text
    assert text.count("<svg") == 1
    assert "<b>cell" not in text
