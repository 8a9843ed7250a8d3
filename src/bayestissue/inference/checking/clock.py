"""Whether the force of a driven tissue is behind its displacement."""

from __future__ import annotations

from typing import Any

from bayestissue.inference.checking import sentence

# In standard errors: those of single impacts scatter by up to a half more than they should.
_LIMIT = 6.0
# Of a sampling interval, below which no delay is worth a word.
_LEAST = 0.25


def judge_clock(channel: str, clock: dict[str, Any]) -> dict[str, Any]:
    """The entry ``clock`` of ``diagnostics.json``, of a fit that takes both clocks for one.

    Args:
        channel: the force's.
        clock: ``lag_s``, what the force is behind the displacement, as
            `bayestissue.inference.factors.noise_left.force_lag` has it; ``se_s``, its standard error; and
            ``interval_s``, the sampling interval.

    Returns:
        Besides these ``passed``, whether the lag is below six standard errors or a quarter of the interval;
        ``first``, what the first line of the run is to say, and ``words``, both empty where it passed.
    """
    lag, se = clock["lag_s"], clock["se_s"]
    passed = abs(lag) < _LIMIT * se or abs(lag) < _LEAST * clock["interval_s"]
    if passed:
        return clock | {"passed": True, "first": "", "words": ""}
    side = "behind" if lag > 0 else "ahead of"
    numbers = {"channel": channel, "size": f"{1e3 * abs(lag):.2g}", "se": f"{1e3 * se:.1g}", "side": side}
    said = {name: sentence(f"clock.{name}", **numbers) for name in ("first", "words")}
    return clock | {"passed": False, **said}
