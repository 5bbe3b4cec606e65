"""Prior of standard parameters: by link as it was made, relative or absolute."""

import numpy as np
import pytest

from onboard.dynamics.model.errors import UnknownFrameError, UrdfError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.regressor.prior import LinkSigmas, prior_root
from tests.regressor.test_base_parameters import rocksat

ARM = LinkSigmas(mass_relative=0.01, centre_m=5e-4, inertia_relative=0.02)
REST = {"plate": 1.0, "tip_mass": 1.0}
BIAS = {"bias_load_cell": 2.0}


def test_a_link_that_was_made_scatters_as_the_prior_says(rng):
    model = rocksat()
    own = slice(10 * model.vehicle.links.index("arm"), 10 * model.vehicle.links.index("arm") + 10)
    drawn = body_of(model.chi[own])
    half_trace = 0.5 * np.trace(drawn.inertia_kg_m2)
    made = []
    for _ in range(4000):
        off = np.triu(rng.standard_normal((3, 3)))
        inertia = drawn.inertia_kg_m2 + ARM.inertia_relative * half_trace * (off + np.triu(off, 1).T)
        mass = drawn.mass_kg * (1.0 + ARM.mass_relative * rng.standard_normal())
        made.append(
            standard_of(RigidBody(mass, drawn.centre_of_mass_m + ARM.centre_m * rng.standard_normal(3), inertia))
        )
    root = prior_root(model, REST, BIAS, {"arm": ARM})
    covariance, seen = root @ root.T, np.cov(np.array(made).T)
    size = np.sqrt(np.diag(seen))
    assert (size > 0.0).all()
    np.testing.assert_allclose(covariance[own, own] / np.outer(size, size), seen / np.outer(size, size), atol=0.08)
    assert not covariance[own][:, np.r_[0 : own.start, own.stop : len(model.names)]].any()


def test_other_columns_have_their_own_sigmas():
    model = rocksat()
    root = prior_root(model, REST, BIAS, {"arm": ARM})
    at = model.names.index("bias_load_cell")
    assert root[at, at] == 2.0
    np.testing.assert_array_equal(root, prior_root(model, REST, BIAS, {"arm": ARM}))
    both = prior_root(model, REST | {"arm": 0.5}, BIAS)
    np.testing.assert_array_equal(both, np.diag(np.diag(both)))


@pytest.mark.parametrize(
    ("relative", "extras", "made", "said"),
    [
        (REST, BIAS, {"arm": ARM, "ram": ARM}, "the prior names 'ram'"),
        (REST | {"arm": 0.1}, BIAS, {"arm": ARM}, "an absolute and a relative sigma"),
        (REST, BIAS | {"M_arm": 0.1}, {"arm": ARM}, "M_arm has an absolute sigma"),
        (REST, BIAS, {}, "arm"),
    ],
)
def test_what_is_stated_twice_or_not_at_all_is_refused(relative, extras, made, said):
    with pytest.raises(UnknownFrameError, match=said):
        prior_root(rocksat(), relative, extras, made)


def test_a_link_without_mass_was_never_weighed():
    model = rocksat()
    own = slice(10 * model.vehicle.links.index("arm"), 10 * model.vehicle.links.index("arm") + 10)
    chi = model.chi.copy()
    chi[own] = 0.0
    model.chi = chi
    with pytest.raises(UrdfError, match="no mass"):
        prior_root(model, REST, BIAS, {"arm": ARM})
