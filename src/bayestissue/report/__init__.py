"""Tables, figures and pages for people."""

from bayestissue.report.writing import write_report

__all__ = ["write_report"]
