"""The small campaign of whole fits in tests: of one size, so that what one compiles serves the others."""

from __future__ import annotations

FOUR_BY_FOUR = """
name = "four by four"
seed = 4
[design]
subjects = 4
[[design.conditions]]
trial = "m0.4"
mass_kg = 0.4
velocity_m_s = 1.5
[[design.conditions]]
trial = "m0.6"
mass_kg = 0.6
velocity_m_s = 1.5
[[design.conditions]]
trial = "m0.9"
mass_kg = 0.9
velocity_m_s = 1.5
[[design.conditions]]
trial = "m1.3"
mass_kg = 1.3
velocity_m_s = 1.5
[tissue]
K_N_per_m = 3000.0
C_N_s_per_m = 25.0
sd_subject_K = 0.2
sd_impact_K = 0.05
sd_subject_C = 0.2
sd_impact_C = 0.05
[recording]
sampling_rate_hz = 2000.0
noise_relative_to_peak = 0.005
relative_mass_sd = 0.002
velocity_sd_m_s = 0.005
[output]
traces = "csv"
"""
