"""The No-U-Turn sampler: compiled once, one chain a processor core, the same draws for the same seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from numpyro.infer import MCMC, NUTS, init_to_median
from numpyro.infer.util import initialize_model
from scipy.optimize import minimize

from bayestissue import runtime
from bayestissue.hierarchy.specification import Sampler
from bayestissue.inference.execution.progress import Progress, silent

STATISTICS = ("diverging", "num_steps", "accept_prob", "energy", "potential_energy")


@dataclass(frozen=True)
class Draws:
    """What the sampler returned: ``sites`` [chain, draw, ...] and ``statistics`` [chain, transition]."""

    sites: dict[str, np.ndarray]
    statistics: dict[str, np.ndarray]
    max_tree_depth: int

    def thinned(self, thinning: int) -> Draws:
        """The same with the last of so many draws only, and the statistics of all."""
        sites = {name: values[:, thinning - 1 :: thinning] for name, values in self.sites.items()}
        return replace(self, sites=sites)


class PosteriorSampler:
    """One compiled chain that serves every data set of the same shapes.

    A chain starts where an ascent of the density ends, with the inverse Hessian there for its first mass
    matrix, which adaptation then replaces: the parameters' scales differ a hundredfold, and from a unit
    matrix the first window alone walks through full trees. The model's arguments are traced rather than
    baked in, so refits without a trial and competing formulas cost no compilation. Chains run in threads
    of one device: they share nothing, while JAX's virtual devices wait for each other at every transfer.
    """

    def __init__(self, model: Callable[..., None], settings: Sampler) -> None:
        self.settings = settings
        self._model = model
        self._compiled: Callable[..., Any] | None = None

    def run(
        self, seed: int, data_sets: Sequence[tuple[Any, ...]], *, progress: Progress = silent
    ) -> list[Draws]:
        """Draw from the posterior of each of ``data_sets``, the arguments of the model.

        ``progress`` is told how many of all chains are finished. The draws depend on ``seed`` and on the
        place of a data set in the list, and not on the number of cores.
        """
        chains = self.settings.chains
        key = jax.random.key(seed)
        if self._compiled is None:
            self._prepare(key, data_sets[0])
        modes = [self._mode(arguments) for arguments in data_sets]
        jobs = [(number, chain) for number in range(len(data_sets)) for chain in range(chains)]
        inputs = [
            jax.tree.map(
                lambda part: np.asarray(part)[None],
                (
                    jax.random.key_data(jax.random.fold_in(jax.random.fold_in(key, number), chain)),
                    *modes[number],
                    *data_sets[number],
                ),
            )
            for number, chain in jobs
        ]
        if self._compiled is None:
            self._compiled = jax.jit(jax.vmap(self._chain)).lower(*inputs[0]).compile()
        compiled = self._compiled
        progress(0, len(jobs))
        with ThreadPoolExecutor(runtime.cores()) as pool:
            futures = [pool.submit(lambda x: jax.device_get(compiled(*x)), x) for x in inputs]
            try:
                for done, _ in enumerate(as_completed(futures), start=1):
                    progress(done, len(jobs))
            finally:
                # An interrupted run waits for the chains under way, not for those that queue.
                pool.shutdown(wait=False, cancel_futures=True)
        results = [future.result() for future in futures]
        sites, statistics = jax.tree.map(lambda *parts: np.concatenate(parts), *results)
        own = [slice(number * chains, (number + 1) * chains) for number in range(len(data_sets))]
        return [
            Draws(
                {name: values[part] for name, values in sites.items()},
                {name: values[part] for name, values in statistics.items()},
                self.settings.max_tree_depth,
            ).thinned(self.settings.thinning)
            for part in own
        ]

    def _prepare(self, key: jax.Array, arguments: tuple[Any, ...]) -> None:
        start, potential_of, *_ = initialize_model(
            key, self._model, model_args=arguments, dynamic_args=True, init_strategy=init_to_median()
        )
        self._start, self._unravel = ravel_pytree(start.z)

        def potential(flat: jax.Array, *arguments: Any) -> jax.Array:
            return potential_of(*arguments)(self._unravel(flat))

        self._value_and_gradient = jax.jit(jax.value_and_grad(potential))
        self._hessian = jax.jit(jax.hessian(potential))

    def _mode(self, arguments: tuple[Any, ...]) -> tuple[np.ndarray, np.ndarray]:
        """A point of high unconstrained density and a positive definite inverse Hessian there."""

        def objective(flat: np.ndarray) -> tuple[float, np.ndarray]:
            value, gradient = self._value_and_gradient(flat, *arguments)
            return float(value), np.asarray(gradient)

        found = minimize(objective, np.asarray(self._start), jac=True, method="L-BFGS-B")
        curvature, axes = np.linalg.eigh(np.asarray(self._hessian(found.x, *arguments)))
        # A direction that the mode leaves flat, as the log of a small spread is, gets unit scale.
        return found.x, (axes / np.maximum(curvature, 1.0)) @ axes.T

    def _chain(self, key_data: jax.Array, mode: jax.Array, inverse_mass: jax.Array, *arguments: Any) -> Any:
        start_key, key = jax.random.split(jax.random.wrap_key_data(key_data))
        noise = jax.random.normal(start_key, mode.shape)
        # Half a posterior standard deviation of scatter lets R-hat see chains that did not forget it.
        start = mode + 0.5 * jnp.linalg.cholesky(inverse_mass) @ noise
        kernel = NUTS(
            self._model,
            target_accept_prob=self.settings.target_accept,
            max_tree_depth=self.settings.max_tree_depth,
            inverse_mass_matrix=inverse_mass,
            dense_mass=True,
        )
        mcmc = MCMC(
            kernel,
            num_warmup=self.settings.warmup,
            num_samples=self.settings.transitions,
            num_chains=1,
            progress_bar=False,
        )
        mcmc.run(key, *arguments, init_params=self._unravel(start), extra_fields=STATISTICS)
        return mcmc.get_samples(), mcmc.get_extra_fields()
