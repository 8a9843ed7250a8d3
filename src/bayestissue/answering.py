"""What every finished fit answers, in memory or read back from its folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayestissue import runtime
from bayestissue.inference.answers.finished import Finished
from bayestissue.outline import Outlined

if TYPE_CHECKING:
    import pandas as pd


class Answering(Outlined):
    """What can be asked of a finished fit, be it in memory or read back from its folder."""

    @property
    def finished(self) -> Finished:
        """The fit as questions and predictions need it."""
        raise NotImplementedError

    def ask(self, *questions: str) -> pd.DataFrame:
        """Answers to questions, as `bayestissue ask` and ``bayestissue ask --help`` have them.

        Args:
            questions: such as ``"K[subject=s01] / K[subject=s02] > 1.1"``, a claim, or ``"K[mass_kg=1.2]"``.

        Returns:
            A row for each: see `bayestissue.inference.answers.questions.ask`.

        Raises:
            InputError: some can't be read, or ask for what this fit does not have: all that is wrong at once.
        """
        from bayestissue.inference.answers.questions import ask, numbered

        return ask(self.finished, numbered(questions))

    def predict(self, table: str | Path | pd.DataFrame) -> pd.DataFrame:
        """K, C, greatest depth and force, and time to peak of new impacts, with 90 % intervals.

        Args:
            table: a CSV file or a pandas table: a row for each new impact, with any of the columns of
                ``impacts.csv``. Numbers and categories not given are at the reference; a person, condition or
                other level that is not given, or was not measured, is a new one of its population.

        Returns:
            A row for each: see `bayestissue.inference.answers.predictions.predict`.

        Raises:
            InputError: the table is wrong: all that is, by row, column and value.
        """
        from bayestissue.inference.answers.predictions import predict
        from bayestissue.inference.answers.table import read_conditions

        return runtime.in_float64(predict)(self.finished, read_conditions(table, self.finished.recorded))
