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
# # The published estimates, looked at with ArviZ
#
# `bayestissue reproduce --out reports/published` writes a report and, beside it, `posterior.nc`: an ArviZ
# DataTree with everything the sampler drew. The report shows what was asked most often. This notebook opens
# the draws themselves, for whatever else you want to ask.
#
# It is kept as text. In `make shell`, `pip install jupytext notebook` and then
# `jupytext --to ipynb notebooks/published.py` make a notebook of it. Set the environment variable `BAYESTISSUE_RUN`
# to look at another run than `reports/published`.

# %%
import os
from pathlib import Path

import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr

az.style.use("arviz-variat")
here = Path.cwd()
root = here if (here / "pyproject.toml").is_file() else here.parent
folder = Path(os.environ.get("BAYESTISSUE_RUN", root / "reports" / "published"))
with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as stored:
    run = stored.load()
posterior = run["posterior"].dataset
print(
    f"{posterior.sizes['chain']} chains of {posterior.sizes['draw']} draws; groups: {', '.join(run.children)}"
)

# %% [markdown]
# ## Did the sampler do its work?
#
# Before any number is believed: the chains must tell the same story. R̂ near 1 (below 1.01), an effective
# sample size of several hundred. The first table shows the worst first.

# %%
population = [
    f"{stem}_{quantity}"
    for quantity in ("K", "C")
    for stem in ("intercept", "mass_exponent", "sd_subject", "sd_trial", "sd_impact")
    if f"{stem}_{quantity}" in posterior
]
table = az.summary(run, var_names=population, ci_kind="eti", ci_prob=0.9, round_to="none").astype(float)
table.sort_values("r_hat", ascending=False).round(4)

# %% [markdown]
# Traces should look like noise about one level, the same for every chain; the densities of the chains should
# lie on each other.

# %%
az.plot_trace_dist(run, var_names=population[:3])
plt.show()

# %% [markdown]
# Rank plots say the same more strictly: each line is one chain's ranks among all draws, as a difference from
# what chains that agree would show. Above each panel stands how probable such differences are if the chains
# agree: below 0.01 it needs a look.

# %%
az.plot_rank(run, var_names=population)
plt.show()

# %% [markdown]
# ## The mass exponents
#
# The question of the whole analysis. A tissue of fixed stiffness has exponent 0. Since K = M ω², a method
# whose ω says nothing of the tissue gives exponent 1.

# %%
exponents = [name for name in ("mass_exponent_K", "mass_exponent_C") if name in posterior]
if exponents:
    az.plot_forest(run, var_names=exponents, combined=True, ci_kind="eti", ci_probs=(0.5, 0.9))
    plt.show()
pd.read_csv(folder / "hypotheses.csv")

# %% [markdown]
# ## People
#
# The effect of each person on log K and log C. Where all intervals hold zero, the estimates don't tell one
# person from another.

# %%
effects = [name for name in ("subject_effect_K", "subject_effect_C") if name in posterior]
if effects:
    az.plot_forest(run, var_names=effects, combined=True, ci_kind="eti", ci_probs=(0.5, 0.9))
    plt.show()

# %% [markdown]
# ## K and C together
#
# The spread of the impacts and the correlation between their K and their C, and a new person's K and C at the
# reference mass. A slanted cloud says that what is known of one tells something of the other.

# %%
az.plot_pair(run, var_names=["K_new", "C_new"])
plt.show()
if "residual_correlation" in posterior:
    low, median, high = np.percentile(posterior["residual_correlation"], [5, 50, 95])
    print(
        f"correlation of log K and log C from impact to impact: {median:.2f} (90 %: {low:.2f} to {high:.2f})"
    )

# %% [markdown]
# ## Would this model have given these data?
#
# The black line is what was published, the others are data sets drawn from the fitted model. Where they part,
# the model lacks something.

# %%
az.plot_ppc_dist(run, var_names=["K_observed", "C_observed"], num_samples=40)
plt.show()

# %% [markdown]
# ## How ω changes with the mass
#
# From the draws one can compute whatever one likes, and its interval comes along. Here: the natural frequency
# √(K/M) of a typical person in each condition, and its ratio between the heaviest and the lightest impactor.
# A tissue of fixed stiffness would give a ratio of √(lightest/heaviest).

# %%
mass = run["constant_data"]["mass_kg"]
omega = np.sqrt(posterior["K_trial"] / mass)
order = mass.sortby(mass)["trial"]
ratio = omega.sel(trial=order[-1]) / omega.sel(trial=order[0])
low, median, high = np.percentile(ratio, [5, 50, 95])
fixed = float(np.sqrt(mass.min() / mass.max()))
print(f"ratio of ω: {median:.3f} (90 %: {low:.3f} to {high:.3f}); a fixed stiffness would give {fixed:.3f}")

quantiles = omega.quantile([0.05, 0.5, 0.95], dim=["chain", "draw"]).transpose("quantile", "trial")
middle = quantiles.sel(quantile=0.5)
figure, axes = plt.subplots()
axes.errorbar(
    mass,
    middle,
    [middle - quantiles.sel(quantile=0.05), quantiles.sel(quantile=0.95) - middle],
    fmt="o",
    label="posterior, 90 %",
)
grid = np.linspace(float(mass.min()), float(mass.max()), 50)
anchor = float(middle.sel(trial=order[0])) * np.sqrt(float(mass.min()))
axes.plot(grid, anchor / np.sqrt(grid), "--", label="a tissue of fixed stiffness")
axes.set(xlabel="mass of the impactor, M (kg)", ylabel="ω = √(K/M) (rad/s)", ylim=(0, None))
axes.legend()
plt.show()
