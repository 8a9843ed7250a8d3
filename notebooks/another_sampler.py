# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The same posterior by another sampler
#
# `fit` draws from its posterior by a Markov chain of its own. `bt.numpyro_model` is the same model for numpyro's
# samplers, so that the two can be compared, and the model can be looked into: here by the No-U-Turn sampler, which
# follows the slopes of the density. It takes minutes where the chain takes seconds; a few impacts are enough.

# %%
import arviz as az
import jax
import numpy as np
import numpyro
import pandas as pd
from numpyro.infer import MCMC, NUTS

import bayestissue as bt
from bayestissue.base.resources import shared

# The likelihoods need double precision.
numpyro.enable_x64()
whole = bt.read_dataset(shared("data", "example"))
rows = np.flatnonzero(whole.impacts["subject"].isin(["s01", "s02", "s03"]) & (whole.impacts["mass_kg"] > 0.9))
traces = [(whole.traces[row].time_s, whole.traces[row].value) for row in rows]
few = bt.dataset(
    whole.impacts.iloc[rows].reset_index(drop=True),
    traces,
    quantity=whole.quantity,
    unit="m/s^2",
    uncertainty=vars(whole.uncertainty),
)
print(f"{len(few.impacts)} impacts of {few.impacts['subject'].nunique()} people")

# %% [markdown]
# ## The fit, and the trajectories

# %%
model = {
    "name": "few",
    "likelihood": "impact",
    "discrepancy": "none",
    "formula": {"K": "(1|subject)", "C": "(1|subject)"},
}
fit = bt.fit(few, model, seed=1)
print(fit.verdict)

# %%
kernel = NUTS(bt.numpyro_model(few, model), target_accept_prob=0.9)
trajectories = MCMC(
    kernel, num_warmup=500, num_samples=500, num_chains=2, chain_method="sequential", progress_bar=False
)
trajectories.run(jax.random.key(1))
drawn = trajectories.get_samples(group_by_chain=True)

# %% [markdown]
# ## Side by side
#
# Names are the same in both. What is compared are means, in units of what both samplers leave open of them.

# %%
ours, table = fit.posterior["posterior"], []
for name in ("intercept_K", "sd_subject_K", "sd_impact_K", "intercept_C", "sd_impact_C", "sd_noise"):
    means, errors = [], []
    for values in (ours[name].to_numpy(), np.asarray(drawn[name])):
        one = az.convert_to_dataset({"x": values})
        means.append(values.mean())
        errors.append(values.std() / np.sqrt(float(az.ess(one)["x"])))
    table.append((name, *means, (means[0] - means[1]) / np.hypot(*errors)))
table = pd.DataFrame(table, columns=["quantity", "chain", "trajectories", "difference in errors"])
print("greatest difference:", round(float(table["difference in errors"].abs().max()), 1), "errors")
table.round(4)
