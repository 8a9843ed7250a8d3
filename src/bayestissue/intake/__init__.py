"""From a folder of recorder files to a dataset: what files say, what is asked, what is made of it."""

from bayestissue.intake.build import Cutting
from bayestissue.intake.choices import Choices, Question
from bayestissue.intake.init import Intake, default_out, init_dataset, prepare, write

__all__ = ["Choices", "Cutting", "Intake", "Question", "default_out", "init_dataset", "prepare", "write"]
