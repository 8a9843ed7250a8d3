"""What every file of a result folder holds: which commands write it, and what each row and column means.

The manual's page of result files is made of this table, and a test holds it to what commands write.
"""

from __future__ import annotations

from typing import NamedTuple

# Columns that mean the same in every file.
_MEANING = {
    "impact": "the impact's name",
    "subject": "the person",
    "trial": "the condition",
    "mass_kg": "mass of the impactor",
    "velocity_m_s": "velocity at contact",
    "n_samples": "samples that were used",
    "sampling_interval_s": "time between two samples",
    "K_N_per_m": "stiffness",
    "C_N_s_per_m": "damping",
    "omega_n_rad_s": "natural frequency, √(K/M)",
    "zeta": "damping ratio, C / (2 √(K M))",
    "peak_displacement_m": "greatest depth",
    "time_to_peak_s": "time from contact to it",
    "contact_time_s": "moment of contact on the recorder's clock",
    "variable": "name of the quantity, as in posterior.nc",
    "label": "the impact, person or other level that it is of; empty where there is one alone",
    "unit": "its unit",
    "quantity": "K, C or an element's further parameter",
    "median": "posterior median",
    "low": "lower end of the 90 % interval",
    "high": "upper end of the 90 % interval",
    "eti90_low": "lower end of the 90 % interval",
    "eti90_high": "upper end of the 90 % interval",
    "scheme": "what was left out and predicted: one impact, one person, one condition at a time",
    "elpd": "expected log predictive density of what was left out; greater is better",
    "warning": "why a score may be wrong; empty if nothing speaks against it",
    "note": "what to know about this row; empty if nothing",
    "prior_overlap": "overlap of posterior and prior: 0 where the data say all, 1 where they say nothing",
    "ratio": "posterior median of the first over the second",
    "value": "what was found",
    "row": "row of the file",
    "column": "column or key",
    "file": "the file that it is in",
    "expected": "what was expected",
    "remedy": "what to do",
    "code": "its entry in the manual's page of warnings and errors, and of `bayestissue explain`",
}


class File(NamedTuple):
    """A file of a result folder.

    Attributes:
        by: the commands that write it.
        holds: what it is; of a table what a row is.
        columns: of a table, each column with its meaning.
    """

    by: tuple[str, ...]
    holds: str
    columns: dict[str, str]


def _table(by: str, holds: str, columns: str, **own: str) -> File:
    """A table of these columns; ``own`` are meanings that `_MEANING` lacks or has otherwise."""
    known = _MEANING | own
    return File(tuple(by.split()), holds, {name: known[name] for name in columns.split()})


def _estimate_errors(q: str, unit: str) -> dict[str, str]:
    words = {"se": "standard error of {q}", "low": "lower end of {q}'s 90 % interval", "high": "upper end"}
    return {f"{q}_{end}_{unit}": told.format(q=q) for end, told in words.items()}


_OF_ERRORS = _estimate_errors("K", "N_per_m") | _estimate_errors("C", "N_s_per_m")
_ESTIMATES = (
    "impact subject trial mass_kg velocity_m_s n_samples sampling_interval_s phi1 phi2 theta1 sigma_a "
    "omega_n_rad_s zeta K_N_per_m C_N_s_per_m peak_displacement_m time_to_peak_s flags "
    f"{' '.join(_OF_ERRORS)} omega_n_se_rad_s zeta_se theta1_se log_likelihood whiteness_p notes"
)
_OF_ESTIMATES = _OF_ERRORS | {
    "phi1": "first autoregressive coefficient of the displacement",
    "phi2": "second autoregressive coefficient",
    "theta1": "moving-average coefficient",
    "sigma_a": "standard deviation of the shocks in m; empty by the method impact",
    "flags": "what is wrong with the impact; empty if nothing",
    "omega_n_se_rad_s": "standard error of the natural frequency",
    "zeta_se": "standard error of the damping ratio",
    "theta1_se": "standard error of theta1; empty by the method impact",
    "log_likelihood": "log likelihood of the trace",
    "whiteness_p": "probability of residuals like these if they were white noise; small where they are "
    "structured",
    "notes": "what is no fault of the impact but a property of the method or the recorder",
    "noise_sd_m_s2": "standard deviation of the recorder's noise; of the method impact alone",
    "pareto_k": "of the importance weights; of the method impact alone",
}
_PROBLEM = "file row column impact value expected remedy code"
_SCORES = "elpd se elpd_difference se_difference p_effective weight warning"
_OF_SCORES = {
    "model": "name of the run or of the explanation",
    "data": "the numbers that are predicted; only rows of the same ones can be compared",
    "se": "standard error of elpd",
    "elpd_difference": "elpd less that of the best",
    "se_difference": "standard error of that difference",
    "p_effective": "effective number of parameters",
    "weight": "stacking weight; the weights of a scheme add up to 1",
}
_STATISTIC = "the number that is compared, such as the mass exponent of K"

FILES: dict[str, File] = {
    "posterior.nc": File(("fit", "reproduce"), "draws, predictions and data, an ArviZ DataTree (netCDF)", {}),
    "report.html": File(
        ("fit", "reproduce", "estimate", "compare", "causes"), "the page; it needs no other file", {}
    ),
    "check.html": File(("check",), "a page with a panel for each impact", {}),
    "init.html": File(("init",), "a page that shows what was understood of the recordings", {}),
    "run.json": File(
        ("fit", "reproduce", "estimate", "compare", "causes"),
        "versions, the model as it was resolved, seed, hash of the input, seconds, and the verdict of the "
        "diagnostics",
        {},
    ),
    "diagnostics.json": File(
        ("fit", "reproduce"),
        "each check of the sampler with its value, limit, meaning and next step; model_form, measuring_chain "
        "and recordings say what else is in doubt; model_form.impacts has the p-value of each impact's "
        "residuals being the model's noise",
        {},
    ),
    ".bayestissue.json": File(("all",), "which files the program wrote, and so may replace", {}),
    "summary.csv": _table(
        "fit reproduce",
        "a quantity, of each impact, person or condition where there are several",
        "variable label unit mean sd median eti50_low eti50_high eti90_low eti90_high ess_bulk ess_tail "
        "r_hat mcse_mean note",
        mean="posterior mean",
        sd="posterior standard deviation",
        eti50_low="lower end of the 50 % interval",
        eti50_high="upper end of the 50 % interval",
        ess_bulk="effective sample size for the middle of the distribution",
        ess_tail="effective sample size for the ends of intervals",
        r_hat="how well the chains agree; below 1.01 is good",
        mcse_mean="Monte Carlo standard error of the mean",
        note="where an interval can't be read as one: why; of `fit` alone",
    ),
    "hypotheses.csv": _table(
        "fit reproduce",
        "a hypothesis about a mass exponent",
        "quantity hypothesis value rope_low rope_high probability",
        quantity="whose mass exponent: K, C, or K at a depth",
        hypothesis="in words",
        value="the exponent that it states; empty for what lies between",
        rope_low="from this exponent on",
        rope_high="up to this one: nearer counts as equal in practice",
        probability="posterior probability that the exponent lies there",
    ),
    "contrasts.csv": _table(
        "fit",
        "a level against another, such as left against right",
        "factor level against quantity ratio low high p_direction p_equivalent",
        factor="the column that is compared",
        level="the first level",
        against="the second level",
        ratio="posterior median of the first level's K (or C) over the second's",
        p_direction="probability of the likelier direction, above or below 1",
        p_equivalent="probability that the ratio counts as 1 in practice",
    ),
    "people.csv": _table(
        "fit",
        "a person against another",
        "quantity person against p_greater ratio low high",
        person="the first person",
        against="the second person",
        p_greater="probability that the first person's is greater",
    ),
    "reliability.csv": _table(
        "fit",
        "a measure of how repeatable a measurement of a person is",
        "quantity measure form median low high unit prior_overlap varies",
        measure="intraclass correlation, standard error of measurement, minimal detectable change, repeats",
        form="which form of it, such as ICC(A,1)",
        varies="groups whose levels may differ between the measurements; all else is the same",
    ),
    "agreement.csv": _table(
        "fit",
        "two methods on the same impacts",
        "quantity method against impacts left_out ratio low high",
        method="the first method: dds, exact or posterior",
        against="the second method",
        impacts="impacts that both gave a value for",
        left_out="impacts without a value by one of them",
        ratio="geometric mean of the first over the second",
        low="lower 95 % limit of agreement",
        high="upper 95 % limit of agreement",
    ),
    "interval_sources.csv": _table(
        "fit",
        "a source of the uncertainty of log K or log C",
        "level quantity source share sd",
        level="of an impact, a typical person, a new person, or a trace alone",
        source="noise, contact moment, velocity and gain, mass, people and so on; all is their sum",
        share="of the posterior variance",
        sd="what the source alone would make the standard deviation of the log",
    ),
    "cross_validation.csv": _table(
        "fit",
        "an impact, person or condition that was predicted from all others",
        "scheme label elpd pareto_k warning",
        label="what was left out",
        pareto_k="of the importance weights; above its limit the score may be wrong",
    ),
    "sensitivity.csv": _table(
        "fit reproduce",
        "how a quantity of the population depends on priors and data",
        "variable prior likelihood diagnosis",
        prior="change with the strength of the priors; above 0.05 it depends on them",
        likelihood="change with the strength of the data",
        diagnosis="both in words; a check mark where the data decide",
    ),
    "questions.csv": _table(
        "fit ask",
        "a question",
        "question posterior prior bayes_factor mcse prior_mcse median low high unit draws prior_draws name "
        "note",
        question="as it was asked",
        posterior="probability of a claim after the data",
        prior="probability of a claim before the data",
        bayes_factor="posterior odds over prior odds; above 1 the data speak for the claim",
        mcse="Monte Carlo standard error of the probability, or of the median",
        prior_mcse="that of the prior probability",
        median="posterior median of an expression",
        unit="unit of the median and the interval; empty if it is not that of a quantity",
        draws="draws of the posterior",
        prior_draws="draws of the prior",
        name="what the model file calls it",
    ),
    "predictions.csv": _table(
        "predict",
        "a new impact; what the table gave, then",
        "K_N_per_m C_N_s_per_m peak_displacement_m peak_force_N time_to_peak_s new draws simulated note",
        K_N_per_m="stiffness, median; with _low and _high the ends of its 90 % interval, as of the next",
        peak_force_N="greatest force",
        new="the groups of which it has a level that was not measured",
        draws="draws of the posterior",
        simulated="how many of them were simulated for depth, force and time",
    ),
    "estimates.csv": _table(
        "estimate",
        "an impact by itself",
        _ESTIMATES.removesuffix("notes") + "noise_sd_m_s2 pareto_k notes",
        **_OF_ESTIMATES,
    ),
    "estimates_exact.csv": _table(
        "fit", "an impact by itself, by the method exact", _ESTIMATES, **_OF_ESTIMATES
    ),
    "estimates_dds.csv": _table("fit", "an impact by itself, by the method dds", _ESTIMATES, **_OF_ESTIMATES),
    "vary.csv": _table(
        "estimate",
        "a value of a choice of the signal chain, of --vary",
        "choice value estimated K_N_per_m_median K_N_per_m_5 K_N_per_m_95 C_N_s_per_m_median C_N_s_per_m_5 "
        "C_N_s_per_m_95 note",
        choice="what was varied",
        value="to what",
        estimated="impacts with an estimate",
        K_N_per_m_median="median of K over the impacts",
        K_N_per_m_5="5 % of the impacts are below",
        K_N_per_m_95="95 % of the impacts are below",
        C_N_s_per_m_median="median of C over the impacts",
        C_N_s_per_m_5="5 % of the impacts are below",
        C_N_s_per_m_95="95 % of the impacts are below",
    ),
    "centring.csv": _table(
        "estimate",
        "a mass that hits one simulated tissue, of --method dds",
        "mass_kg K_N_per_m C_N_s_per_m K_centred C_centred K_rest C_rest",
        K_N_per_m="the true stiffness",
        C_N_s_per_m="the true damping",
        K_centred="K by the thesis's fit about the sample mean",
        C_centred="C by the thesis's fit about the sample mean",
        K_rest="K by the exact fit about the rest position",
        C_rest="C by the exact fit about the rest position",
    ),
    "left_out.csv": _table("estimate", "something wrong with an impact that --skip-bad left out", _PROBLEM),
    "quality.csv": _table(
        "check",
        "a recording",
        "impact subject trial n_samples sampling_rate_hz offset noise_sd peak noise_to_peak samples_at_peak "
        "contact_time_s contact_time_sd_s time_to_peak_s peak_displacement_m samples_in_window warnings",
        n_samples="samples recorded",
        sampling_rate_hz="samples in a second",
        offset="taken off the recording; its unit ends the name, as in offset_m_s2",
        noise_sd="standard deviation of the noise; its unit ends the name",
        peak="greatest value; its unit ends the name",
        noise_to_peak="noise over peak",
        samples_at_peak="samples that share the greatest value; many mean a recorder at its limit",
        contact_time_sd_s="standard deviation of the moment of contact",
        samples_in_window="samples from contact to zero velocity",
        warnings="how many warnings name the impact",
    ),
    "problems.csv": _table(
        "check",
        "something wrong or odd",
        f"severity {_PROBLEM}",
        severity="warning, or left out by --skip-bad",
    ),
    "comparison.csv": _table(
        "compare reproduce",
        "a run or an explanation, the best first",
        f"scheme data model {_SCORES}",
        **_OF_SCORES,
    ),
    "posteriors.csv": _table(
        "compare",
        "a quantity by a run",
        "variable label of unit run median eti90_low eti90_high",
        of="what its interval is of",
        run="name of the run",
    ),
    "implied.csv": _table(
        "compare",
        "a quantity that means the same in all runs, by their stacking weights",
        "scheme data variable label of unit runs median eti90_low eti90_high",
        data=_OF_SCORES["data"],
        of="what its interval is of",
        runs="runs that weigh at least a hundredth",
        median="median of the weighted posteriors",
    ),
    "reproduction.csv": _table(
        "reproduce",
        "a published number",
        "table row quantity published reproduced agrees note",
        table="the thesis's table",
        row="its row",
        quantity="what the number is",
        published="as printed",
        reproduced="recomputed from what else was published; empty where it can't be",
        agrees="whether they are equal after rounding to the printed digits",
        note="why they are not, or why it can't be recomputed",
    ),
    "audit.csv": _table(
        "reproduce",
        "a finding about the published numbers",
        "where what published implied severity explanation",
        where="in which tables",
        what="of what",
        published="what was printed",
        implied="what follows from the other numbers",
        severity="major, minor or note",
        explanation="why it matters",
    ),
    "predictive_checks.csv": _table(
        "reproduce",
        "a statistic of the data beside what the model predicts",
        "statistic quantity observed predicted_median predicted_low predicted_high p_value",
        statistic="such as the smallest value",
        observed="of the data",
        predicted_median="median of data that the model makes",
        predicted_low="lower end of their 90 % interval",
        predicted_high="upper end of it",
        p_value="share of the model's data with a greater value; near 0 or 1 the model does not fit",
    ),
    "truth.csv": _table(
        "simulate fit",
        "an impact of a simulated dataset; effects of further groups follow",
        "impact K_N_per_m C_N_s_per_m omega_n_rad_s zeta mass_kg velocity_m_s gain offset_m_s2 "
        "contact_time_s time_to_peak_s peak_displacement_m subject_effect_K subject_effect_C "
        "trial_effect_K trial_effect_C impact_effect_K impact_effect_C",
        K_N_per_m="true stiffness",
        C_N_s_per_m="true damping",
        mass_kg="true mass",
        velocity_m_s="true velocity at contact",
        gain="recorded over true deceleration",
        offset_m_s2="the recorder's zero",
        **{
            f"{group}_effect_{q}": f"effect of the {group} on log {q}"
            for group in ("subject", "trial", "impact")
            for q in ("K", "C")
        },
    ),
    "causes.csv": _table(
        "causes",
        "a proposed cause; p_* are the p values of each statistic",
        "cause title campaigns complete probability probability_error p_joint smallest_p "
        "calibration_below_10 calibration_below_50 calibration_campaigns calibration_p nearest fails verdict",
        cause="its key in the model file",
        title="what the page calls it",
        campaigns="simulated campaigns",
        complete="share of them with an estimate of every statistic",
        probability="posterior probability, the causes being equally likely before",
        probability_error="its standard error",
        p_joint="share of its campaigns at least as strange as the observed one, by all statistics",
        smallest_p="the smallest value that p_joint can have",
        calibration_below_10="share of held-out campaigns of this cause with a p_joint below 0.1",
        calibration_below_50="the same below 0.5",
        calibration_campaigns="how many were held out",
        calibration_p="probability of shares so far from 0.1 and 0.5 if p_joint is right",
        nearest="strengths of its campaigns that are nearest to the observed one",
        fails="statistics that it can't explain",
        verdict="refuted, doubtful or possible",
    ),
    "causes/reliability.csv": _table(
        "causes",
        "a range of probabilities that was given to causes of simulated campaigns",
        "probability right cases",
        probability="mean probability that was given",
        right="share of them that were the true cause; equal where probabilities can be trusted",
        cases="how many were given",
    ),
    "observed.csv": _table(
        "causes",
        "a statistic of the estimates",
        "statistic value compared",
        statistic=_STATISTIC,
        compared="whether it is part of the comparison",
    ),
    "predictive.csv": _table(
        "causes",
        "a statistic under a cause",
        "cause statistic q01 q05 q25 q50 q75 q95 q99",
        cause="the cause",
        statistic=_STATISTIC,
        **{f"q{share:02d}": f"{share} % of its campaigns are below" for share in (1, 5, 25, 50, 75, 95, 99)},
    ),
    "confusion.csv": _table(
        "causes",
        "a true cause; a column for each cause has the mean probability that its campaigns give it",
        "truth",
        truth="the cause that made the campaigns",
    ),
    "campaigns.parquet": File(
        ("causes",), "every simulated campaign: its cause, strengths and statistics", {}
    ),
}
