"""From a folder of recorder files to a dataset: what files say, what is asked, what is made of it."""

from bayestissue.recordings.intake.choices import Question, choices_of, options

__all__ = ["Question", "choices_of", "options"]
