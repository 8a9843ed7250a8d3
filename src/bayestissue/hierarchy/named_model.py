"""The model of a fit as numpyro's samplers take it, its sites named as in a finished fit."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpyro

from bayestissue.hierarchy.derived import effects_by_name
from bayestissue.hierarchy.trace_data import Prepared
from bayestissue.hierarchy.traces import plain_model


def named_model(prepared: Prepared) -> Callable[[], None]:
    """`plain_model` of a fit's data, with effects, K and C by their names beside what is sampled.

    K and C are at the recorded mass, whose error, where impacts share it, is ``log_mass_error``. A
    discrepancy is there as the log of its rms.
    """
    model = prepared.model

    def named() -> None:
        if not jax.config.jax_enable_x64:
            raise RuntimeError("these likelihoods need double precision: call numpyro.enable_x64() first")
        with numpyro.handlers.trace() as sampled:
            plain_model(model, jax.tree.map(jnp.asarray, prepared.data))
        value = {name: site["value"] for name, site in sampled.items() if site["type"] == "sample"}
        effects = effects_by_name(model.locations, prepared.design, value["locations"])
        for name, effect in effects.items():
            numpyro.deterministic(name, effect)
        for number, q in enumerate("KC"):
            numpyro.deterministic(q, jnp.exp(value["log_K_and_C"][:, number]))

    return named
