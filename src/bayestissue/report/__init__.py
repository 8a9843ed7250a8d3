"""Tables, figures and pages for people."""

from bayestissue.report.run_folder import write_report

__all__ = ["write_report"]
