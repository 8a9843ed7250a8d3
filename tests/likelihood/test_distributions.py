from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import pytest
import tinygp
from numpyro.infer.util import log_density

from bayestissue.likelihood import ARMA21, sine_transforms
from bayestissue.oscillator import to_differences
from bayestissue.oscillator.processes import start_moments


@pytest.mark.parametrize("zeta", [0.1, 0.45, 0.8, 2.0])
def test_sampled_a2_is_the_sho_kernel_of_tinygp(zeta: float) -> None:
    omega_n, dt, n = 80.0, 1e-3, 120
    x = 0.01 * np.random.default_rng(3).normal(size=n).cumsum()
    # the shocks' standard deviation that makes the stationary one 1 cm
    sigma_a = 0.01 / jnp.sqrt(start_moments(*to_differences(omega_n, zeta, dt), 1.0)[0])
    ours = ARMA21.sampled_a2(omega_n, zeta, dt, sigma_a, width=n, start="stationary").log_prob(x)
    kernel = tinygp.kernels.quasisep.SHO(omega=omega_n, quality=1 / (2 * zeta), sigma=0.01)
    theirs = tinygp.GaussianProcess(kernel, dt * np.arange(n), diag=0.0).log_probability(x)
    # well sampled, the kernel's own factor loses (omega_n dt)^3 of its digits
    assert float(ours) == pytest.approx(float(theirs), rel=1e-6)


@pytest.mark.parametrize("start", ["free", "stationary"])
def test_samples_have_the_moments_of_the_density(start: str) -> None:
    # under the true density each score has mean zero and a variance equal to the information
    truth = jnp.array([0.3, 0.08, -0.5, 0.2])
    first = jnp.array([0.0, 0.5])
    draws = ARMA21(*truth, first=first, width=60, start=start).sample(jax.random.key(0), (4000,))

    def value(p: jax.Array, x: jax.Array) -> jax.Array:
        return ARMA21(*p, first=first, width=60, start=start).log_prob(x)

    scores = jax.jit(jax.vmap(jax.grad(value), (None, 0)))(truth, draws)
    z = scores.mean(0) / (scores.std(0) / np.sqrt(len(draws)))
    # four standard normal numbers: beyond 4 once in 4000 times
    assert np.abs(z).max() < 4


def test_stored_transforms_score_as_the_filter_does() -> None:
    x = np.random.default_rng(0).normal(size=(3, 30)).cumsum(1)
    data = sine_transforms(x, np.array([30, 20, 25]))
    event = ARMA21(0.1, 0.02, jnp.array([-0.9, 0.1, 0.8]), 0.5, data=data)
    assert event.batch_shape == (3,)
    np.testing.assert_allclose(event.log_prob(data.x), event.log_prob(data.x + 0.0), rtol=1e-10)


def test_event_of_a_numpyro_model_reads_its_stored_transforms(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("bayestissue.likelihood.arma.distributions.masked_log_likelihood")
    x = np.random.default_rng(0).normal(size=(3, 30)).cumsum(1)
    data = sine_transforms(x)

    def model() -> None:
        theta1 = numpyro.sample("theta1", numpyro.distributions.Uniform(-1, 1))
        with numpyro.plate("impact", 3):
            numpyro.sample("x", ARMA21(0.1, 0.02, theta1, 0.5, data=data), obs=data.x)

    density = jax.jit(lambda t: log_density(model, (), {}, {"theta1": t})[0])(0.3)
    expected = ARMA21(0.1, 0.02, 0.3, 0.5, data=data).log_prob(data.x).sum() - np.log(2)
    assert float(density) == pytest.approx(float(expected), rel=1e-12)
    mcmc = numpyro.infer.MCMC(numpyro.infer.NUTS(model), num_warmup=50, num_samples=50, progress_bar=False)
    mcmc.run(jax.random.key(0))
    assert np.isfinite(mcmc.get_samples()["theta1"]).all()


def test_samples_end_with_the_impact_and_keep_its_first_values() -> None:
    event = ARMA21(0.1, 0.02, 0.3, 0.5, first=jnp.array([[0.0, 1.0], [0.0, 2.0]]), n_samples=[5, 8], width=8)
    draw = np.asarray(event.sample(jax.random.key(1), (4,)))
    assert draw.shape == (4, 2, 8)
    assert (draw[:, 0, 5:] == 0).all()
    assert (draw[:, :, 1] == [1.0, 2.0]).all()
    assert np.isfinite(event.log_prob(draw)).all()
