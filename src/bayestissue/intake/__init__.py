"""From a folder of recorder files to a dataset: what files say, what is asked, what is made of it."""

from bayestissue.intake.choices import Question, choices_of, options
from bayestissue.intake.init import Intake, default_out, init_dataset, prepare, write

__all__ = ["Intake", "Question", "choices_of", "default_out", "init_dataset", "options", "prepare", "write"]
