"""The model file: what is modelled, with which priors, sampled how. Checked whole before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from bayestissue.hierarchy.priors import Priors
from bayestissue.settings import checked, parse_toml, read_text
from bayestissue.signal import SignalOptions

DEFAULT_FORMULA = "log(mass_kg) + (1|subject) + (1|trial)"


Likelihood = Literal["published-estimates", "arma", "a2", "impact"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Formulas(_Table):
    """Right-hand sides for log K and log C, in the notation of R and formulae."""

    K: str = DEFAULT_FORMULA
    C: str = DEFAULT_FORMULA


class PracticalEquivalence(_Table):
    """How near a mass exponent must be to a hypothesis to count as equal to it in practice."""

    mass_exponent: Annotated[float, Field(gt=0, lt=0.5)] = 0.1


class Sampler(_Table):
    """The No-U-Turn sampler's settings."""

    chains: Annotated[int, Field(ge=2, le=64)] = 4
    warmup: Annotated[int, Field(ge=100)] = 1000
    draws: Annotated[int, Field(ge=100)] = 1000
    target_accept: Annotated[float, Field(gt=0.5, lt=1)] = 0.9
    max_tree_depth: Annotated[int, Field(ge=3, le=15)] = 10
    path: Literal["automatic", "exact", "summary"] = Field(
        default="automatic",
        description="exact: every trace in every step. summary: each trace summarised once, then the "
        "hierarchy, then a correction by importance sampling. automatic: exact up to 400 impacts. Only for "
        "traces.",
    )


class Comparison(_Table):
    """Other explanations of the same data: a name and the formula that takes both responses' place."""

    formulas: dict[str, str] = {}


class ModelSpecification(_Table):
    """A whole model file; see `models/` for commented ones."""

    name: Annotated[str, Field(min_length=1)]
    description: str = ""
    likelihood: Likelihood
    signal: SignalOptions = SignalOptions()
    reference_mass_kg: Annotated[float, Field(gt=0)] | None = None
    formula: Formulas = Formulas()
    residual_correlation: bool = True
    mass_error: Literal["impact", "subject"] = Field(
        default="impact",
        description="impact: every impact's mass has an error of its own. subject: the mass is a person's, "
        "such as an effective mass, and its error the same in all of the person's impacts.",
    )
    priors: Priors = Priors()
    practical_equivalence: PracticalEquivalence = PracticalEquivalence()
    comparison: Comparison = Comparison()
    sampler: Sampler = Sampler()


def read_specification(path: Path) -> ModelSpecification:
    """Read and check a model file.

    Raises:
        InputError: the file is missing, is not TOML, or holds a key or value that is not allowed; every
            such key is named with what is allowed.
    """
    name = str(path)
    text = read_text(Path(path), name)
    return checked(parse_toml(text, name), ModelSpecification, file=name, text=text)
