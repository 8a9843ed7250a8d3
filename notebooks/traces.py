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
# # From recorded traces to a decision
#
# The question of this notebook: does the stiffness K of a tissue depend on the mass of what hits it? It goes
# from a folder of recordings to an answer with a probability, and looks at every step that the answer rests on.
#
# The data are simulated, so that the truth is known: ten people, nine conditions, and a tissue whose K and C do
# not depend on the mass at all. Set the environment variable `BAYESTISSUE_DATASET` to use your own folder.
#
# To run it yourself, type in the project's folder `make shell`, `pip install notebook`, and
# `jupyter notebook docs/tutorial/notebook.ipynb`. The project keeps its text in `notebooks/traces.py`.

# %%
import os
from pathlib import Path

import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

import bayestissue as bt
from bayestissue.model.hierarchy.specification import read_specification
from bayestissue.base.resources import shared
from bayestissue.recordings.signal import displacements
from bayestissue.recordings.signal.quality import inspect, raised

az.style.use("arviz-variat")
dataset = bt.read_dataset(os.environ.get("BAYESTISSUE_DATASET", shared("data", "example")))
impacts = dataset.impacts
print(
    f"{len(impacts)} impacts, {impacts['subject'].nunique()} people, {impacts['trial'].nunique()} conditions"
)

# %% [markdown]
# ## What was recorded, and is anything wrong with it?
#
# `read_dataset` refuses a folder with anything wrong in it and names every place. What only looks odd is
# listed here. The measuring chain's uncertainty, as the dataset states it, goes into every interval below.

# %%
signal = displacements(dataset)
odd = [str(problem) for problem in dataset.warnings]
spoilt = raised(inspect(dataset), len(impacts))
odd += [
    f"{i}: {flag}" for i, *flags in zip(impacts["impact"], signal.flags, spoilt) for flag in sum(flags, [])
]
print("\n".join(odd) or "nothing looks odd")
print(dataset.uncertainty)

# %% [markdown]
# One impact: the deceleration, and the displacement that follows from it by two integrations, from contact to
# the moment of zero velocity.

# %%
first = 0
n = signal.n_samples[first]
time = 1e3 * (signal.contact.since_s[first] + signal.dt[first] * np.arange(n))
figure, (above, below) = plt.subplots(2, sharex=True)
above.plot(time, signal.deceleration[first, :n])
above.set(ylabel="deceleration (m/s²)", title=f"impact {impacts['impact'].iloc[first]}")
below.plot(time, 1e3 * signal.x[first, :n])
below.set(xlabel="time since contact (ms)", ylabel="displacement (mm)")
plt.show()

# %% [markdown]
# ## Each impact by itself
#
# `impact` is the posterior given the impact's own deceleration, with intervals that hold; `dds` is the thesis's
# method, conditional least squares about the sample mean. Fit a line to log K over log mass, and the last finds a
# dependence on mass that these tissues do not have.

# %%
estimates = {method: bt.estimate(dataset, method=method) for method in ("impact", "dds")}
log_mass = np.log(impacts["mass_kg"].to_numpy())
for method, table in estimates.items():
    level = table["K_N_per_m"].median()
    slope = np.polyfit(log_mass, np.log(table["K_N_per_m"].to_numpy()), 1)[0]
    slope_C = np.polyfit(log_mass, np.log(table["C_N_s_per_m"].to_numpy()), 1)[0]
    print(
        f"{method:6}: median K {level:.0f} N/m; K goes with mass to the power {slope:.3f}, C to {slope_C:.3f}"
    )

# %% [markdown]
# One recording at a time needs no dataset: two arrays, the mass and the velocity give K and C with their intervals.

# %%
shown = impacts.iloc[0]
one = bt.impact(
    dataset.traces[0].time_s,
    dataset.traces[0].value,
    mass_kg=shown["mass_kg"],
    velocity_m_s=shown["velocity_m_s"],
    uncertainty=dataset.uncertainty,
)
one

# %% [markdown]
# ## The fit
#
# All impacts together: people and conditions have effects of their own, and what the measuring chain may have
# got wrong is part of the model. `impact.toml` is the model for decelerations: a spring and a damper, seen through
# an accelerometer.

# %%
fit = bt.fit(dataset, "impact", seed=1)
print("diagnostics passed:", fit.diagnostics["passed"])
print(fit.verdict)

# %% [markdown]
# ## Did the sampler do its work?
#
# Before any number is believed. R̂ should be below 1.01, effective sample sizes at least 400.

# %%
run = fit.posterior
posterior = run["posterior"].dataset
population = [name for name, values in posterior.data_vars.items() if values.ndim == 2]
table = az.summary(run, var_names=population, ci_kind="eti", ci_prob=0.9, round_to="none").astype(float)
print("least effective sample size:", int(table[["ess_bulk", "ess_tail"]].min().min()))
table.sort_values("r_hat", ascending=False).round(4)

# %% [markdown]
# The chains should look like noise about one level, and each chain's ranks among all draws should stay near the
# line.

# %%
exponents = [name for name in ("mass_exponent_K", "mass_exponent_C") if name in posterior]
shown = [*exponents, "sd_impact_K"]
az.plot_trace_dist(run, var_names=shown)
plt.show()
az.plot_rank(run, var_names=shown)
plt.show()

# %% [markdown]
# ## K of a person
#
# At the reference mass, with its interval. It is wider than that of one impact's estimate would suggest: a new
# measurement of the same person would differ by the spread between impacts as well.

# %%
person = str(posterior["subject"].to_numpy()[0])
K = posterior["K_subject"].sel(subject=person)
low, middle, high = np.percentile(K, [5, 50, 95])
print(f"K of {person}: {middle:.0f} N/m (90 %: {low:.0f} to {high:.0f})")
az.plot_forest(run, var_names=["K_subject"], combined=True, ci_kind="eti", ci_probs=(0.5, 0.9))
plt.show()

# %% [markdown]
# How probable is it that one person's tissue is stiffer than another's? Count the draws.

# %%
other = str(posterior["subject"].to_numpy()[-1])
stiffer = float((K > posterior["K_subject"].sel(subject=other)).mean())
print(f"probability that {person} is stiffer than {other}: {stiffer:.3f}")

# %% [markdown]
# ## The decision
#
# A tissue of fixed stiffness has exponent 0; a method whose natural frequency says nothing of the tissue gives
# exponent 1. An exponent within 0.1 of either counts as equal to it in practice. The rule, made before looking:
# above 0.95 is taken as true, below 0.05 as false, and between them these data don't tell.

# %%
near = read_specification(shared("models", "impact.toml")).practical_equivalence.mass_exponent
for name in exponents:
    draws = posterior[name].to_numpy().ravel()
    low, middle, high = np.percentile(draws, [5, 50, 95])
    print(f"{name}: {middle:.3f} (90 %: {low:.3f} to {high:.3f})")
    for value, words in ((0, "fixed, whatever the mass"), (1, "in proportion to mass")):
        probability = float(np.mean(np.abs(draws - value) < near))
        answer = "yes" if probability > 0.95 else "no" if probability < 0.05 else "these data don't tell"
        print(f"  {words}: probability {probability:.3f}: {answer}")
if exponents:
    az.plot_forest(run, var_names=exponents, combined=True, ci_kind="eti", ci_probs=(0.5, 0.9))
    plt.show()

# %% [markdown]
# ## Would this model have given these traces?
#
# Traces drawn from the fitted model, over what was recorded. The share of recorded samples inside the 90 %
# intervals should be 0.9 or a little more, since the curve to which noise is added is itself uncertain. A share far
# below it says that the noise, or the motion, is not as modelled.

# %%
predicted = run["posterior_predictive"]["deceleration"].isel(impact=first).to_numpy()
predicted = predicted.reshape(-1, predicted.shape[-1])[:, :n]
low, high = np.percentile(predicted, [5, 95], axis=0)
measured = run["observed_data"]["deceleration"].isel(impact=first).to_numpy()[:n]
print(f"inside: {np.mean((measured >= low) & (measured <= high)):.2f}")
figure, axes = plt.subplots()
axes.fill_between(time, low, high, alpha=0.3, label="predicted, 90 %")
axes.plot(time, measured, "k", lw=1, label="recorded")
axes.set(xlabel="time since contact (ms)", ylabel="deceleration (m/s²)")
axes.legend()
plt.show()

# %% [markdown]
# ## Against the truth
#
# A simulated dataset knows it. The 90 % intervals of the impacts should hold the true K about nine times in ten.

# %%
if (dataset.folder / "truth.csv").is_file():
    truth = pd.read_csv(dataset.folder / "truth.csv", dtype={"impact": str}).set_index("impact")
    for quantity, column in (("K", "K_N_per_m"), ("C", "C_N_s_per_m")):
        draws = posterior[quantity]
        true = truth.loc[draws["impact"].to_numpy(), column].to_numpy()
        low, middle, high = draws.quantile([0.05, 0.5, 0.95], dim=["chain", "draw"]).to_numpy()
        held = np.mean((true >= low) & (true <= high))
        off = np.median(np.abs(middle / true - 1))
        thesis = np.median(estimates["dds"][column].to_numpy() / true)
        print(
            f"{quantity}: intervals hold {held:.2f}; median error {100 * off:.1f} %; the thesis's {thesis:.2f} times the truth"
        )

# %% [markdown]
# `fit.report("reports/mine")` writes all of this as a page, with the files of a finished run beside it.
