"""From a folder of recorder files to a dataset: what files say, what is asked, what is made of it."""

from bayestissue.recordings.intake.choices import MissingFact, choices_of, options

__all__ = ["MissingFact", "choices_of", "options"]
