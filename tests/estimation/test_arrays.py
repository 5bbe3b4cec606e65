"""Eigenvectors where LAPACK gives up on a matrix that is sound."""

import numpy as np
import pytest

from onboard.estimation.arrays import eigen


def test_a_matrix_that_lapack_gives_up_on_has_its_eigenvectors(monkeypatch, rng):
    """OpenBLAS 0.3.31 did in a rehearsal, by the lower triangle: the estimator stopped in flight."""
    root, solve = rng.normal(size=(7, 5)), np.linalg.eigh
    matrix = root @ root.T

    def gives_up(of, UPLO="L"):
        if UPLO == "L":
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return solve(of, UPLO)

    monkeypatch.setattr(np.linalg, "eigh", gives_up)
    values, vectors = eigen(matrix)
    np.testing.assert_allclose(vectors * values @ vectors.T, matrix, atol=1e-12)
    assert (np.diff(values) >= 0.0).all()


def test_what_is_not_finite_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        eigen(np.full((3, 3), np.nan))
