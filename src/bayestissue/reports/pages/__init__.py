"""Tables, figures and pages for people."""

from bayestissue.reports.pages.run_folder import write_report

__all__ = ["write_report"]
